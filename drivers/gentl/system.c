/* Which cameras are there?  The library, the system, and its one interface: everything that Aravis finds by GigE Vision. */
#include <stdio.h>
#include <string.h>

#include "producer.h"

static Module system_module;
static Module interface_module;
static GMutex lock; /* guards what follows */
static int initialized;
static GPtrArray *found_devices;
static GPtrArray *open_devices;

GENTL_API GcError GCInitLib(void)
{
    g_mutex_lock(&lock);
    if (initialized++ == 0 && found_devices == NULL) {
        arv_disable_interface("Fake");
        arv_disable_interface("USB3Vision");
        module_init(&system_module, SYSTEM, "TLPort", "TLSystem");
        module_init(&interface_module, INTERFACE, "InterfacePort", "TLInterface");
        found_devices = g_ptr_array_new();
        open_devices = g_ptr_array_new();
    }
    g_mutex_unlock(&lock);
    return GC_SUCCESS;
}

/* What was found is kept: a consumer may close the library and open it again, as Harvester.update() does. */
GENTL_API GcError GCCloseLib(void)
{
    g_mutex_lock(&lock);
    if (initialized > 0) initialized--;
    g_mutex_unlock(&lock);
    return GC_SUCCESS;
}

static GcError system_info(int32_t what, GcType *type, void *buffer, size_t *size)
{
    switch (what) {
    case TL_ID: return give_text("slabcell-aravis", type, buffer, size);
    case TL_VENDOR: return give_text(VENDOR, type, buffer, size);
    case TL_MODEL:
    case TL_DISPLAYNAME: return give_text(MODEL, type, buffer, size);
    case TL_VERSION: return give_text(VERSION, type, buffer, size);
    case TL_TLTYPE: return give_text(TL_TYPE, type, buffer, size);
    case TL_NAME:
    case TL_PATHNAME: return give_text("slabcell_aravis.cti", type, buffer, size);
    case TL_ENCODING: return give_i32(1, type, buffer, size); /* UTF-8 */
    case TL_MAJOR: return give_u32(1, type, buffer, size);
    case TL_MINOR: return give_u32(5, type, buffer, size);
    default: return fail(GC_NOT_AVAILABLE, "system information %d is not available", what);
    }
}

GENTL_API GcError GCGetInfo(int32_t what, GcType *type, void *buffer, size_t *size)
{
    return system_info(what, type, buffer, size);
}

GENTL_API GcError TLOpen(Handle *system)
{
    if (system == NULL) return fail(GC_INVALID_PARAMETER, "no place for the handle");
    if (initialized == 0) return fail(GC_NOT_INITIALIZED, "GCInitLib comes first");
    *system = &system_module;
    return GC_SUCCESS;
}

GENTL_API GcError TLClose(Handle system)
{
    REQUIRE(system, SYSTEM);
    return GC_SUCCESS;
}

GENTL_API GcError TLGetInfo(Handle system, int32_t what, GcType *type, void *buffer, size_t *size)
{
    REQUIRE(system, SYSTEM);
    return system_info(what, type, buffer, size);
}

GENTL_API GcError TLUpdateInterfaceList(Handle system, Bool8 *changed, uint64_t timeout_ms)
{
    (void) timeout_ms;
    REQUIRE(system, SYSTEM);
    if (changed != NULL) *changed = 0;
    return GC_SUCCESS;
}

GENTL_API GcError TLGetNumInterfaces(Handle system, uint32_t *count)
{
    REQUIRE(system, SYSTEM);
    if (count == NULL) return fail(GC_INVALID_PARAMETER, "no place for the number");
    *count = 1;
    return GC_SUCCESS;
}

GENTL_API GcError TLGetInterfaceID(Handle system, uint32_t index, char *id, size_t *size)
{
    REQUIRE(system, SYSTEM);
    if (index != 0) return fail(GC_INVALID_INDEX, "there is one interface");
    return give_text(INTERFACE_ID, NULL, id, size);
}

static GcError interface_info(int32_t what, GcType *type, void *buffer, size_t *size)
{
    switch (what) {
    case IF_ID: return give_text(INTERFACE_ID, type, buffer, size);
    case IF_DISPLAYNAME: return give_text("GigE Vision (Aravis)", type, buffer, size);
    case IF_TLTYPE: return give_text(TL_TYPE, type, buffer, size);
    default: return fail(GC_NOT_AVAILABLE, "interface information %d is not available", what);
    }
}

GENTL_API GcError TLGetInterfaceInfo(Handle system, const char *id, int32_t what, GcType *type, void *buffer, size_t *size)
{
    REQUIRE(system, SYSTEM);
    if (g_strcmp0(id, INTERFACE_ID) != 0) return fail(GC_INVALID_ID, "there is no interface %s", id ? id : "");
    return interface_info(what, type, buffer, size);
}

GENTL_API GcError TLOpenInterface(Handle system, const char *id, Handle *interface)
{
    REQUIRE(system, SYSTEM);
    if (g_strcmp0(id, INTERFACE_ID) != 0) return fail(GC_INVALID_ID, "there is no interface %s", id ? id : "");
    if (interface == NULL) return fail(GC_INVALID_PARAMETER, "no place for the handle");
    *interface = &interface_module;
    return GC_SUCCESS;
}

GENTL_API GcError IFClose(Handle interface)
{
    REQUIRE(interface, INTERFACE);
    return GC_SUCCESS;
}

GENTL_API GcError IFGetInfo(Handle interface, int32_t what, GcType *type, void *buffer, size_t *size)
{
    REQUIRE(interface, INTERFACE);
    return interface_info(what, type, buffer, size);
}

GENTL_API GcError IFGetParentTL(Handle interface, Handle *system)
{
    REQUIRE(interface, INTERFACE);
    if (system == NULL) return fail(GC_INVALID_PARAMETER, "no place for the handle");
    *system = &system_module;
    return GC_SUCCESS;
}

GENTL_API GcError IFUpdateDeviceList(Handle interface, Bool8 *changed, uint64_t timeout_ms)
{
    (void) timeout_ms; /* it takes a second, or less where addresses are given */
    REQUIRE(interface, INTERFACE);
    GPtrArray *seen = discover();
    g_mutex_lock(&lock);
    if (changed != NULL) *changed = seen->len != found_devices->len;
    g_ptr_array_unref(found_devices);
    found_devices = seen;
    g_mutex_unlock(&lock);
    return GC_SUCCESS;
}

GENTL_API GcError IFGetNumDevices(Handle interface, uint32_t *count)
{
    REQUIRE(interface, INTERFACE);
    if (count == NULL) return fail(GC_INVALID_PARAMETER, "no place for the number");
    g_mutex_lock(&lock);
    *count = found_devices->len;
    g_mutex_unlock(&lock);
    return GC_SUCCESS;
}

GENTL_API GcError IFGetDeviceID(Handle interface, uint32_t index, char *id, size_t *size)
{
    REQUIRE(interface, INTERFACE);
    g_mutex_lock(&lock);
    GcError error = index < found_devices->len
                        ? give_text(((Found *) g_ptr_array_index(found_devices, index))->id, NULL, id, size)
                        : fail(GC_INVALID_INDEX, "there are %u devices", found_devices->len);
    g_mutex_unlock(&lock);
    return error;
}

static Found *find(const char *id)
{
    for (guint i = 0; i < found_devices->len; i++) {
        Found *found = g_ptr_array_index(found_devices, i);
        if (g_strcmp0(found->id, id) == 0) return found;
    }
    return NULL;
}

static bool is_open(const char *id)
{
    for (guint i = 0; i < open_devices->len; i++)
        if (g_strcmp0(((Device *) g_ptr_array_index(open_devices, i))->id, id) == 0) return true;
    return false;
}

static GcError device_info(const char *id, int32_t what, GcType *type, void *buffer, size_t *size)
{
    const Found *found = find(id);
    if (found == NULL) return fail(GC_INVALID_ID, "there is no device %s", id ? id : "");
    char *name;
    GcError error;
    switch (what) {
    case DEV_ID: return give_text(found->id, type, buffer, size);
    case DEV_VENDOR: return give_text(found->vendor, type, buffer, size);
    case DEV_MODEL: return give_text(found->model, type, buffer, size);
    case DEV_TLTYPE: return give_text(TL_TYPE, type, buffer, size);
    case DEV_DISPLAYNAME:
        name = g_strdup_printf("%s %s (%s)", found->vendor, found->model, found->serial);
        error = give_text(name, type, buffer, size);
        g_free(name);
        return error;
    case DEV_ACCESS:
        return give_i32(is_open(id) ? ACCESS_STATUS_OPEN_READ_WRITE : ACCESS_STATUS_READ_WRITE, type, buffer, size);
    case DEV_SERIAL: return give_text(found->serial, type, buffer, size);
    case DEV_TICKS: return give_u64(1000000000, type, buffer, size); /* Aravis gives nanoseconds */
    default: return fail(GC_NOT_AVAILABLE, "device information %d is not available", what);
    }
}

GENTL_API GcError IFGetDeviceInfo(Handle interface, const char *id, int32_t what, GcType *type, void *buffer, size_t *size)
{
    REQUIRE(interface, INTERFACE);
    g_mutex_lock(&lock);
    GcError error = device_info(id, what, type, buffer, size);
    g_mutex_unlock(&lock);
    return error;
}

GENTL_API GcError DevGetInfo(Handle device, int32_t what, GcType *type, void *buffer, size_t *size)
{
    REQUIRE(device, DEVICE);
    return IFGetDeviceInfo(&interface_module, ((Device *) device)->id, what, type, buffer, size);
}

GENTL_API GcError IFOpenDevice(Handle interface, const char *id, int32_t access, Handle *device)
{
    REQUIRE(interface, INTERFACE);
    if (id == NULL || device == NULL) return fail(GC_INVALID_PARAMETER, "no device");
    g_mutex_lock(&lock);
    GcError error = GC_SUCCESS;
    if (is_open(id)) {
        error = fail(GC_RESOURCE_IN_USE, "device %s is open already", id);
    } else {
        Device *opened = device_open(id, access != ACCESS_READ_ONLY, &error);
        if (opened != NULL) g_ptr_array_add(open_devices, opened);
        *device = opened;
    }
    g_mutex_unlock(&lock);
    return error;
}

GENTL_API GcError DevGetParentIF(Handle device, Handle *interface)
{
    REQUIRE(device, DEVICE);
    if (interface == NULL) return fail(GC_INVALID_PARAMETER, "no place for the handle");
    *interface = &interface_module;
    return GC_SUCCESS;
}

GENTL_API GcError DevClose(Handle device)
{
    REQUIRE(device, DEVICE);
    Device *closing = device;
    g_mutex_lock(&lock);
    g_ptr_array_remove(open_devices, closing);
    g_mutex_unlock(&lock);
    if (closing->stream != NULL) stream_free(closing->stream);
    g_object_unref(closing->arv);
    g_free((char *) closing->module.xml);
    g_free((char *) closing->remote.xml);
    g_free(closing->id);
    closing->module.kind = closing->remote.kind = 0; /* a handle used once more is refused, not followed */
    g_free(closing);
    return GC_SUCCESS;
}
