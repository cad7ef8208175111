/* How do pictures reach the consumer?  Its buffers, announced and queued, filled by Aravis and told by an event. */
#include <string.h>

#include "producer.h"

#define SOCKET_BUFFER_BYTES (16 << 20)
#define SLICE_US 20000 /* how long a wait may be before it looks whether it was killed */

static Buffer *buffer_of(Stream *stream, Handle handle)
{
    return g_ptr_array_find(stream->buffers, handle, NULL) ? handle : NULL;
}

/* Hands a queued buffer to Aravis, which owns a reference of its own. */
static void push(Stream *stream, Buffer *buffer)
{
    buffer->queued = true;
    buffer->delivered = false;
    if (stream->stream != NULL) arv_stream_push_buffer(stream->stream, g_object_ref(buffer->arv));
}

static Buffer *match(Stream *stream, ArvBuffer *arv)
{
    for (guint i = 0; i < stream->buffers->len; i++) {
        Buffer *buffer = g_ptr_array_index(stream->buffers, i);
        if (buffer->arv == arv) return buffer;
    }
    return NULL;
}

static void stop(Stream *stream)
{
    g_mutex_lock(&stream->lock);
    ArvStream *ending = stream->stream;
    stream->stream = NULL;
    g_mutex_unlock(&stream->lock);
    if (ending != NULL) g_object_unref(ending); /* ends its thread and lets go of our buffers */
}

void stream_free(Stream *stream)
{
    stop(stream);
    for (guint i = 0; i < stream->buffers->len; i++) {
        Buffer *buffer = g_ptr_array_index(stream->buffers, i);
        g_object_unref(buffer->arv);
        g_free(buffer);
    }
    g_ptr_array_free(stream->buffers, TRUE);
    if (stream->event != NULL) {
        stream->event->module.kind = 0;
        g_free(stream->event);
    }
    g_free((char *) stream->module.xml);
    g_mutex_clear(&stream->lock);
    stream->device->stream = NULL;
    stream->module.kind = 0;
    g_free(stream);
}

GENTL_API GcError DSClose(Handle handle)
{
    REQUIRE(handle, STREAM);
    stream_free(handle);
    return GC_SUCCESS;
}

GENTL_API GcError DSGetParentDev(Handle handle, Handle *device)
{
    REQUIRE(handle, STREAM);
    if (device == NULL) return fail(GC_INVALID_PARAMETER, "no place for the handle");
    *device = ((Stream *) handle)->device;
    return GC_SUCCESS;
}

GENTL_API GcError DSAnnounceBuffer(Handle handle, void *base, size_t size, void *user, Handle *announced)
{
    REQUIRE(handle, STREAM);
    if (base == NULL || size == 0 || announced == NULL) return fail(GC_INVALID_PARAMETER, "no memory is given");
    Stream *stream = handle;
    Buffer *buffer = g_new0(Buffer, 1);
    buffer->arv = arv_buffer_new(size, base);
    buffer->base = base;
    buffer->size = size;
    buffer->user = user;
    g_mutex_lock(&stream->lock);
    g_ptr_array_add(stream->buffers, buffer);
    g_mutex_unlock(&stream->lock);
    *announced = buffer;
    return GC_SUCCESS;
}

GENTL_API GcError DSAllocAndAnnounceBuffer(Handle handle, size_t size, void *user, Handle *announced)
{
    REQUIRE(handle, STREAM);
    if (size == 0 || announced == NULL) return fail(GC_INVALID_PARAMETER, "no size is given");
    Stream *stream = handle;
    Buffer *buffer = g_new0(Buffer, 1);
    size_t there;
    buffer->arv = arv_buffer_new_allocate(size);
    buffer->base = (void *) arv_buffer_get_data(buffer->arv, &there);
    buffer->size = size;
    buffer->user = user;
    g_mutex_lock(&stream->lock);
    g_ptr_array_add(stream->buffers, buffer);
    g_mutex_unlock(&stream->lock);
    *announced = buffer;
    return GC_SUCCESS;
}

GENTL_API GcError DSRevokeBuffer(Handle handle, Handle which, void **base, void **user)
{
    REQUIRE(handle, STREAM);
    Stream *stream = handle;
    g_mutex_lock(&stream->lock);
    Buffer *buffer = buffer_of(stream, which);
    bool busy = buffer != NULL && stream->stream != NULL && buffer->queued;
    if (buffer != NULL && !busy) g_ptr_array_remove(stream->buffers, buffer);
    g_mutex_unlock(&stream->lock);
    if (buffer == NULL) return fail(GC_INVALID_HANDLE, "this buffer is not announced");
    if (busy) return fail(GC_BUSY, "the buffer is being filled");
    if (base != NULL) *base = buffer->base;
    if (user != NULL) *user = buffer->user;
    g_object_unref(buffer->arv);
    g_free(buffer);
    return GC_SUCCESS;
}

GENTL_API GcError DSQueueBuffer(Handle handle, Handle which)
{
    REQUIRE(handle, STREAM);
    Stream *stream = handle;
    g_mutex_lock(&stream->lock);
    Buffer *buffer = buffer_of(stream, which);
    if (buffer != NULL && !buffer->queued) push(stream, buffer);
    g_mutex_unlock(&stream->lock);
    return buffer != NULL ? GC_SUCCESS : fail(GC_INVALID_HANDLE, "this buffer is not announced");
}

/* Takes back what is filled; with the lock held. */
static void discard_filled(Stream *stream)
{
    ArvBuffer *arv;
    while (stream->stream != NULL && (arv = arv_stream_try_pop_buffer(stream->stream)) != NULL) {
        Buffer *buffer = match(stream, arv);
        if (buffer != NULL) buffer->queued = false;
        g_object_unref(arv);
    }
}

GENTL_API GcError DSFlushQueue(Handle handle, int32_t what)
{
    REQUIRE(handle, STREAM);
    Stream *stream = handle;
    g_mutex_lock(&stream->lock);
    if (what == QUEUE_OUTPUT_DISCARD || what == QUEUE_ALL_DISCARD || what == QUEUE_ALL_TO_INPUT) discard_filled(stream);
    for (guint i = 0; i < stream->buffers->len; i++) {
        Buffer *buffer = g_ptr_array_index(stream->buffers, i);
        if (what == QUEUE_ALL_DISCARD && stream->stream == NULL) buffer->queued = false;
        if ((what == QUEUE_ALL_TO_INPUT || what == QUEUE_UNQUEUED_TO_INPUT) && !buffer->queued) push(stream, buffer);
    }
    g_mutex_unlock(&stream->lock);
    return GC_SUCCESS;
}

GENTL_API GcError DSStartAcquisition(Handle handle, int32_t flags, uint64_t count)
{
    (void) flags;
    (void) count; /* the camera counts: AcquisitionMode */
    REQUIRE(handle, STREAM);
    Stream *stream = handle;
    if (stream->stream != NULL) return fail(GC_RESOURCE_IN_USE, "the acquisition runs already");
    ArvDevice *device = stream->device->arv;
    GError *error = NULL;
    if (ARV_IS_GV_DEVICE(device))
        arv_gv_device_set_stream_options(ARV_GV_DEVICE(device), ARV_GV_STREAM_OPTION_PACKET_SOCKET_DISABLED);
    ArvStream *created = arv_device_create_stream(device, NULL, NULL, &error);
    if (created == NULL) return fail_with(error, "the stream cannot be started");
    if (ARV_IS_GV_STREAM(created))
        g_object_set(created, "socket-buffer", ARV_GV_STREAM_SOCKET_BUFFER_FIXED, "socket-buffer-size",
                     SOCKET_BUFFER_BYTES, NULL);
    g_mutex_lock(&stream->lock);
    stream->stream = created;
    stream->started++;
    for (guint i = 0; i < stream->buffers->len; i++) {
        Buffer *buffer = g_ptr_array_index(stream->buffers, i);
        if (buffer->queued) push(stream, buffer);
    }
    g_mutex_unlock(&stream->lock);
    return GC_SUCCESS;
}

GENTL_API GcError DSStopAcquisition(Handle handle, int32_t flags)
{
    (void) flags;
    REQUIRE(handle, STREAM);
    stop(handle);
    return GC_SUCCESS;
}

GENTL_API GcError DSGetInfo(Handle handle, int32_t what, GcType *type, void *buffer, size_t *size)
{
    REQUIRE(handle, STREAM);
    Stream *stream = handle;
    guint64 completed = 0, failures = 0, underruns = 0;
    gint waiting_in = 0, waiting_out = 0;
    g_mutex_lock(&stream->lock);
    size_t announced = stream->buffers->len;
    bool running = stream->stream != NULL;
    if (running) {
        arv_stream_get_statistics(stream->stream, &completed, &failures, &underruns);
        arv_stream_get_n_buffers(stream->stream, &waiting_in, &waiting_out);
    }
    g_mutex_unlock(&stream->lock);
    switch (what) {
    case DS_ID: return give_text(STREAM_ID, type, buffer, size);
    case DS_DELIVERED: return give_u64(stream->delivered, type, buffer, size);
    case DS_UNDERRUN: return give_u64(underruns, type, buffer, size);
    case DS_ANNOUNCED: return give_size(announced, type, buffer, size);
    case DS_QUEUED: return give_size((size_t) MAX(0, waiting_in), type, buffer, size);
    case DS_AWAITING: return give_size((size_t) MAX(0, waiting_out), type, buffer, size);
    case DS_STARTED: return give_u64(stream->started, type, buffer, size);
    case DS_GRABBING: return give_bool(running, type, buffer, size);
    case DS_DEFINES_PAYLOAD: return give_bool(false, type, buffer, size); /* the camera's PayloadSize says it */
    case DS_TLTYPE: return give_text(TL_TYPE, type, buffer, size);
    case DS_CHUNKS_MAX: return give_size(0, type, buffer, size);
    case DS_ANNOUNCE_MIN: return give_size(2, type, buffer, size);
    case DS_ALIGNMENT: return give_size(1, type, buffer, size);
    default: return fail(GC_NOT_AVAILABLE, "stream information %d is not available", what);
    }
}

GENTL_API GcError DSGetBufferID(Handle handle, uint32_t index, Handle *buffer)
{
    REQUIRE(handle, STREAM);
    Stream *stream = handle;
    if (buffer == NULL) return fail(GC_INVALID_PARAMETER, "no place for the handle");
    g_mutex_lock(&stream->lock);
    Handle found = index < stream->buffers->len ? g_ptr_array_index(stream->buffers, index) : NULL;
    g_mutex_unlock(&stream->lock);
    if (found == NULL) return fail(GC_INVALID_INDEX, "there is no buffer %u", index);
    *buffer = found;
    return GC_SUCCESS;
}

GENTL_API GcError DSGetBufferInfo(Handle handle, Handle which, int32_t what, GcType *type, void *out, size_t *size)
{
    REQUIRE(handle, STREAM);
    Stream *stream = handle;
    g_mutex_lock(&stream->lock);
    Buffer *buffer = buffer_of(stream, which);
    bool running = stream->stream != NULL;
    g_mutex_unlock(&stream->lock);
    if (buffer == NULL) return fail(GC_INVALID_HANDLE, "this buffer is not announced");
    switch (what) {
    case BUF_BASE: return give_pointer(buffer->base, type, out, size);
    case BUF_SIZE: return give_size(buffer->size, type, out, size);
    case BUF_USER_PTR: return give_pointer(buffer->user, type, out, size);
    case BUF_QUEUED: return give_bool(buffer->queued, type, out, size);
    case BUF_ACQUIRING: return give_bool(running && buffer->queued, type, out, size);
    case BUF_NEW_DATA: return give_bool(buffer->delivered, type, out, size);
    case BUF_TLTYPE: return give_text(TL_TYPE, type, out, size);
    default: break;
    }
    if (!buffer->delivered) return fail(GC_NO_DATA, "this buffer has not been filled");
    ArvBuffer *arv = buffer->arv;
    bool whole = arv_buffer_get_status(arv) == ARV_BUFFER_STATUS_SUCCESS;
    bool image = arv_buffer_get_payload_type(arv) == ARV_BUFFER_PAYLOAD_TYPE_IMAGE;
    size_t filled = 0;
    switch (what) {
    case BUF_INCOMPLETE: return give_bool(!whole, type, out, size);
    case BUF_TIMESTAMP:
    case BUF_TIMESTAMP_NS: return give_u64(arv_buffer_get_timestamp(arv), type, out, size);
    case BUF_FRAME_ID: return give_u64(arv_buffer_get_frame_id(arv), type, out, size);
    case BUF_SIZE_FILLED:
    case BUF_DATA_SIZE:
        arv_buffer_get_data(arv, &filled);
        return give_size(filled, type, out, size);
    case BUF_IMAGE_PRESENT: return give_bool(image, type, out, size);
    case BUF_HAS_CHUNKS: return give_bool(false, type, out, size);
    case BUF_TOO_LARGE: return give_bool(arv_buffer_get_status(arv) == ARV_BUFFER_STATUS_SIZE_MISMATCH, type, out, size);
    case BUF_PAYLOAD_TYPE: return give_size(PAYLOAD_IMAGE, type, out, size);
    default: break;
    }
    if (!image) return fail(GC_NO_DATA, "this buffer holds no picture");
    switch (what) {
    case BUF_WIDTH: return give_size((size_t) arv_buffer_get_image_width(arv), type, out, size);
    case BUF_HEIGHT:
    case BUF_DELIVERED_HEIGHT: return give_size((size_t) arv_buffer_get_image_height(arv), type, out, size);
    case BUF_X_OFFSET: return give_size((size_t) arv_buffer_get_image_x(arv), type, out, size);
    case BUF_Y_OFFSET: return give_size((size_t) arv_buffer_get_image_y(arv), type, out, size);
    case BUF_X_PADDING:
    case BUF_Y_PADDING:
    case BUF_IMAGE_OFFSET: return give_size(0, type, out, size);
    case BUF_PIXEL_FORMAT: return give_u64(arv_buffer_get_image_pixel_format(arv), type, out, size);
    case BUF_PIXEL_NAMESPACE: return give_u64(NAMESPACE_PFNC_32, type, out, size);
    case BUF_ENDIANNESS: return give_i32(ENDIANNESS_LITTLE, type, out, size);
    default: return fail(GC_NOT_AVAILABLE, "buffer information %d is not available", what);
    }
}

GENTL_API GcError GCRegisterEvent(Handle source, int32_t what, Handle *event)
{
    if (event == NULL) return fail(GC_INVALID_PARAMETER, "no place for the handle");
    if (!is_a(source, STREAM) || what != EVENT_NEW_BUFFER)
        return fail(GC_NOT_IMPLEMENTED, "only streams have events, of new buffers");
    Stream *stream = source;
    if (stream->event != NULL) return fail(GC_RESOURCE_IN_USE, "the event is registered already");
    Event *registered = g_new0(Event, 1);
    registered->module.kind = EVENT;
    registered->stream = stream;
    stream->event = registered;
    *event = registered;
    return GC_SUCCESS;
}

GENTL_API GcError GCUnregisterEvent(Handle source, int32_t what)
{
    REQUIRE(source, STREAM);
    Stream *stream = source;
    if (what != EVENT_NEW_BUFFER || stream->event == NULL) return fail(GC_INVALID_PARAMETER, "no such event");
    stream->event->module.kind = 0;
    g_free(stream->event);
    stream->event = NULL;
    return GC_SUCCESS;
}

/* Waits for a filled buffer without the lock; a stream that ends meanwhile stays until the wait is over. */
static ArvBuffer *wait_for_buffer(Event *event, uint64_t timeout_ms)
{
    gint64 deadline_us = timeout_ms > G_MAXINT64 / 2000 ? G_MAXINT64 : g_get_monotonic_time() + (gint64) timeout_ms * 1000;
    for (;;) {
        g_mutex_lock(&event->stream->lock);
        ArvStream *stream = event->stream->stream != NULL ? g_object_ref(event->stream->stream) : NULL;
        g_mutex_unlock(&event->stream->lock);
        gint64 left_us = MIN(deadline_us - g_get_monotonic_time(), SLICE_US);
        ArvBuffer *found = NULL;
        if (stream != NULL) {
            found = left_us > 0 ? arv_stream_timeout_pop_buffer(stream, (guint64) left_us) : arv_stream_try_pop_buffer(stream);
            g_object_unref(stream);
        } else if (left_us > 0) {
            g_usleep((gulong) MIN(left_us, 1000));
        }
        if (found != NULL || g_get_monotonic_time() >= deadline_us || g_atomic_int_get(&event->killed)) return found;
    }
}

GENTL_API GcError EventGetData(Handle handle, void *out, size_t *size, uint64_t timeout_ms)
{
    REQUIRE(handle, EVENT);
    Event *event = handle;
    Stream *stream = event->stream;
    if (out == NULL || size == NULL || *size < sizeof(NewBufferData)) return fail(GC_BUFFER_TOO_SMALL, "no buffer");
    ArvBuffer *arv = wait_for_buffer(event, timeout_ms);
    if (arv == NULL) {
        if (g_atomic_int_compare_and_exchange(&event->killed, 1, 0)) return fail(GC_ABORT, "the wait was killed");
        return fail(GC_TIMEOUT, "no buffer within %" G_GUINT64_FORMAT " ms", (guint64) timeout_ms);
    }
    g_mutex_lock(&stream->lock);
    Buffer *buffer = match(stream, arv);
    g_object_unref(arv);
    if (buffer != NULL) {
        buffer->queued = false;
        buffer->delivered = true;
        stream->delivered++;
        event->fired++;
    }
    g_mutex_unlock(&stream->lock);
    if (buffer == NULL) return fail(GC_ERROR, "a buffer that was revoked was filled");
    NewBufferData data = {buffer, buffer->user};
    memcpy(out, &data, sizeof data);
    *size = sizeof data;
    return GC_SUCCESS;
}

GENTL_API GcError EventGetInfo(Handle handle, int32_t what, GcType *type, void *buffer, size_t *size)
{
    REQUIRE(handle, EVENT);
    Event *event = handle;
    gint waiting_in = 0, waiting_out = 0;
    g_mutex_lock(&event->stream->lock);
    if (event->stream->stream != NULL) arv_stream_get_n_buffers(event->stream->stream, &waiting_in, &waiting_out);
    g_mutex_unlock(&event->stream->lock);
    switch (what) {
    case EVENT_INFO_TYPE: return give_i32(EVENT_NEW_BUFFER, type, buffer, size);
    case EVENT_INFO_IN_QUEUE: return give_size((size_t) MAX(0, waiting_out), type, buffer, size);
    case EVENT_INFO_FIRED: return give_u64(event->fired, type, buffer, size);
    case EVENT_INFO_SIZE_MAX:
    case EVENT_INFO_DATA_SIZE_MAX: return give_size(sizeof(NewBufferData), type, buffer, size);
    default: return fail(GC_NOT_AVAILABLE, "event information %d is not available", what);
    }
}

GENTL_API GcError EventGetDataInfo(Handle handle, const void *in, size_t in_size, int32_t what, GcType *type, void *out, size_t *size)
{
    REQUIRE(handle, EVENT);
    if (in == NULL || in_size < sizeof(NewBufferData)) return fail(GC_INVALID_PARAMETER, "no event");
    const NewBufferData *data = in;
    switch (what) {
    case 0: return give_pointer(data->buffer, type, out, size);
    case 1: return give_pointer(data->user, type, out, size);
    default: return fail(GC_NOT_AVAILABLE, "event data %d is not available", what);
    }
}

GENTL_API GcError EventFlush(Handle handle)
{
    REQUIRE(handle, EVENT);
    Event *event = handle;
    g_mutex_lock(&event->stream->lock);
    discard_filled(event->stream);
    g_mutex_unlock(&event->stream->lock);
    return GC_SUCCESS;
}

GENTL_API GcError EventKill(Handle handle)
{
    REQUIRE(handle, EVENT);
    g_atomic_int_set(&((Event *) handle)->killed, 1);
    return GC_SUCCESS;
}

GENTL_API GcError DSGetBufferChunkData(Handle stream, Handle buffer, void *chunks, size_t *count)
{
    (void) stream;
    (void) buffer;
    (void) chunks;
    if (count != NULL) *count = 0;
    return fail(GC_NOT_IMPLEMENTED, "chunks are not read");
}

GENTL_API GcError DSGetNumBufferParts(Handle stream, Handle buffer, uint32_t *count)
{
    (void) stream;
    (void) buffer;
    if (count != NULL) *count = 0;
    return fail(GC_NO_DATA, "pictures of several parts are not read");
}

GENTL_API GcError DSGetBufferPartInfo(Handle stream, Handle buffer, uint32_t part, int32_t what, GcType *type, void *out, size_t *size)
{
    (void) stream;
    (void) buffer;
    (void) part;
    (void) what;
    (void) type;
    (void) out;
    (void) size;
    return fail(GC_NO_DATA, "pictures of several parts are not read");
}
