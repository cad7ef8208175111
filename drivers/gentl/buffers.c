/* Where do pictures go?  The consumer's buffers: announced, queued, filled by Aravis, and asked about. */
#include "producer.h"

static Buffer *buffer_of(Stream *stream, Handle handle)
{
    return g_ptr_array_find(stream->buffers, handle, NULL) ? handle : NULL;
}

/* Hands a queued buffer to Aravis, which owns a reference of its own. */
void stream_push(Stream *stream, Buffer *buffer)
{
    buffer->queued = true;
    buffer->delivered = false;
    if (stream->stream != NULL) arv_stream_push_buffer(stream->stream, g_object_ref(buffer->arv));
}

Buffer *stream_match(Stream *stream, ArvBuffer *arv)
{
    for (guint i = 0; i < stream->buffers->len; i++) {
        Buffer *buffer = g_ptr_array_index(stream->buffers, i);
        if (buffer->arv == arv) return buffer;
    }
    return NULL;
}

/* Takes back what is filled; with the lock held. */
void stream_discard_filled(Stream *stream)
{
    ArvBuffer *arv;
    while (stream->stream != NULL && (arv = arv_stream_try_pop_buffer(stream->stream)) != NULL) {
        Buffer *buffer = stream_match(stream, arv);
        if (buffer != NULL) buffer->queued = false;
        g_object_unref(arv);
    }
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
    if (buffer != NULL && !buffer->queued) stream_push(stream, buffer);
    g_mutex_unlock(&stream->lock);
    return buffer != NULL ? GC_SUCCESS : fail(GC_INVALID_HANDLE, "this buffer is not announced");
}

GENTL_API GcError DSFlushQueue(Handle handle, int32_t what)
{
    REQUIRE(handle, STREAM);
    Stream *stream = handle;
    g_mutex_lock(&stream->lock);
    if (what == QUEUE_OUTPUT_DISCARD || what == QUEUE_ALL_DISCARD || what == QUEUE_ALL_TO_INPUT) stream_discard_filled(stream);
    for (guint i = 0; i < stream->buffers->len; i++) {
        Buffer *buffer = g_ptr_array_index(stream->buffers, i);
        if (what == QUEUE_ALL_DISCARD && stream->stream == NULL) buffer->queued = false;
        if ((what == QUEUE_ALL_TO_INPUT || what == QUEUE_UNQUEUED_TO_INPUT) && !buffer->queued) stream_push(stream, buffer);
    }
    g_mutex_unlock(&stream->lock);
    return GC_SUCCESS;
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
