/* How is a camera opened?  The device, its port to the camera's memory, and its one stream. */
#include <string.h>

#include "producer.h"

Device *device_open(const char *address, bool control, GcError *failure)
{
    GError *error = NULL;
    ArvDevice *arv = arv_open_device(address, &error);
    if (arv == NULL) {
        *failure = fail_with(error, "the device cannot be opened");
        return NULL;
    }
    if (control && ARV_IS_GV_DEVICE(arv) && !arv_gv_device_is_controller(ARV_GV_DEVICE(arv))) {
        *failure = fail(GC_ACCESS_DENIED, "another client controls %s", address);
        g_object_unref(arv);
        return NULL;
    }
    size_t xml_size = 0;
    const char *xml = arv_device_get_genicam_xml(arv, &xml_size);
    if (xml == NULL || xml_size == 0) {
        *failure = fail(GC_IO, "%s has no description of its features", address);
        g_object_unref(arv);
        return NULL;
    }
    Device *device = g_new0(Device, 1);
    device->arv = arv;
    device->id = g_strdup(address);
    module_init(&device->module, DEVICE, "DevicePort", "TLDevice");
    device->remote = (Module){REMOTE, "Device", "TLRemoteDevice", g_memdup2(xml, xml_size), xml_size};
    *failure = GC_SUCCESS;
    return device;
}

GENTL_API GcError DevGetPort(Handle device, Handle *port)
{
    REQUIRE(device, DEVICE);
    if (port == NULL) return fail(GC_INVALID_PARAMETER, "no place for the handle");
    *port = &((Device *) device)->remote;
    return GC_SUCCESS;
}

GENTL_API GcError DevGetNumDataStreams(Handle device, uint32_t *count)
{
    REQUIRE(device, DEVICE);
    if (count == NULL) return fail(GC_INVALID_PARAMETER, "no place for the number");
    *count = 1;
    return GC_SUCCESS;
}

GENTL_API GcError DevGetDataStreamID(Handle device, uint32_t index, char *id, size_t *size)
{
    REQUIRE(device, DEVICE);
    if (index != 0) return fail(GC_INVALID_INDEX, "there is one stream");
    return give_text(STREAM_ID, NULL, id, size);
}

GENTL_API GcError DevOpenDataStream(Handle device, const char *id, Handle *stream)
{
    REQUIRE(device, DEVICE);
    Device *owner = device;
    if (g_strcmp0(id, STREAM_ID) != 0) return fail(GC_INVALID_ID, "there is no stream %s", id ? id : "");
    if (stream == NULL) return fail(GC_INVALID_PARAMETER, "no place for the handle");
    if (owner->stream != NULL) return fail(GC_RESOURCE_IN_USE, "the stream is open already");
    Stream *opened = g_new0(Stream, 1);
    module_init(&opened->module, STREAM, "StreamPort", "TLDataStream");
    opened->device = owner;
    opened->buffers = g_ptr_array_new();
    g_mutex_init(&opened->lock);
    owner->stream = opened;
    *stream = opened;
    return GC_SUCCESS;
}
