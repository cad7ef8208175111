/* When do pictures come?  A stream is opened, started and stopped; `buffers.c` has its buffers, `events.c` its news. */
#include "producer.h"

#define SOCKET_BUFFER_BYTES (16 << 20)

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
        if (buffer->queued) stream_push(stream, buffer);
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
