/* How does the consumer hear of a picture?  The one event that there is: a buffer was filled. */
#include <string.h>

#include "producer.h"

#define SLICE_US 20000 /* how long a wait may be before it looks whether it was killed */

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
    Buffer *buffer = stream_match(stream, arv);
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
    stream_discard_filled(event->stream);
    g_mutex_unlock(&event->stream->lock);
    return GC_SUCCESS;
}

GENTL_API GcError EventKill(Handle handle)
{
    REQUIRE(handle, EVENT);
    g_atomic_int_set(&((Event *) handle)->killed, 1);
    return GC_SUCCESS;
}
