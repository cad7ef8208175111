/* How does a consumer reach registers and descriptions?  Ports: the camera's own memory, and an XML file for each module. */
#include <stdio.h>
#include <string.h>

#include "producer.h"

/* The XML of a module stands at this address of its port; cameras have their registers far below. */
#define XML_ADDRESS UINT64_C(0x8000000000000000)

static const char module_xml[] =
    "<?xml version=\"1.0\" encoding=\"utf-8\"?>"
    "<RegisterDescription ModelName=\"Module\" VendorName=\"slabcell\" ToolTip=\"\" StandardNameSpace=\"None\""
    " SchemaMajorVersion=\"1\" SchemaMinorVersion=\"1\" SchemaSubMinorVersion=\"0\" MajorVersion=\"1\""
    " MinorVersion=\"0\" SubMinorVersion=\"0\" ProductGuid=\"5A1ABCE1-0000-4000-8000-000000000010\""
    " VersionGuid=\"5A1ABCE1-0000-4000-8000-000000000011\""
    " xmlns=\"http://www.genicam.org/GenApi/Version_1_1\" xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\""
    " xsi:schemaLocation=\"http://www.genicam.org/GenApi/Version_1_1"
    " http://www.genicam.org/GenApi/GenApiSchema_Version_1_1.xsd\">"
    "<Category Name=\"Root\" NameSpace=\"Standard\"></Category>"
    "<Port Name=\"%s\" NameSpace=\"Standard\"></Port>"
    "</RegisterDescription>";

void module_init(Module *module, Kind kind, const char *name, const char *type)
{
    module->kind = kind;
    module->name = name;
    module->type = type;
    module->xml = g_strdup_printf(module_xml, name);
    module->xml_size = strlen(module->xml);
}

bool is_a(const void *handle, Kind kind)
{
    return handle != NULL && ((const Module *) handle)->kind == kind;
}

static bool is_port(const void *handle)
{
    if (handle == NULL) return false;
    Kind kind = ((const Module *) handle)->kind;
    return kind >= SYSTEM && kind <= STREAM;
}

static Device *device_of_remote(Handle port)
{
    return (Device *) ((char *) port - offsetof(Device, remote));
}

GENTL_API GcError GCReadPort(Handle port, uint64_t address, void *buffer, size_t *size)
{
    if (!is_port(port)) return fail(GC_INVALID_HANDLE, "invalid port");
    if (buffer == NULL || size == NULL) return fail(GC_INVALID_PARAMETER, "no buffer");
    const Module *module = port;
    if (address >= XML_ADDRESS) {
        uint64_t offset = address - XML_ADDRESS;
        if (offset > module->xml_size) return fail(GC_INVALID_ADDRESS, "address beyond the XML file");
        size_t there = MIN(*size, module->xml_size - (size_t) offset);
        memset(buffer, 0, *size);
        memcpy(buffer, module->xml + offset, there);
        return GC_SUCCESS;
    }
    if (module->kind != REMOTE) return fail(GC_INVALID_ADDRESS, "this module has no registers");
    if (*size > G_MAXUINT32) return fail(GC_INVALID_PARAMETER, "%zu bytes cannot be read at once", *size);
    GError *error = NULL;
    if (!arv_device_read_memory(device_of_remote(port)->arv, address, (guint32) *size, buffer, &error))
        return fail_with(error, "the camera's memory cannot be read");
    return GC_SUCCESS;
}

GENTL_API GcError GCWritePort(Handle port, uint64_t address, const void *buffer, size_t *size)
{
    if (!is_port(port)) return fail(GC_INVALID_HANDLE, "invalid port");
    if (buffer == NULL || size == NULL || *size > G_MAXUINT32) return fail(GC_INVALID_PARAMETER, "no buffer");
    if (((Module *) port)->kind != REMOTE) return fail(GC_INVALID_ADDRESS, "this module has no registers");
    GError *error = NULL;
    if (!arv_device_write_memory(device_of_remote(port)->arv, address, (guint32) *size, (void *) buffer, &error))
        return fail_with(error, "the camera's memory cannot be written");
    return GC_SUCCESS;
}

GENTL_API GcError GCReadPortStacked(Handle port, StackEntry *entries, size_t *count)
{
    if (entries == NULL || count == NULL) return fail(GC_INVALID_PARAMETER, "no entries");
    size_t wanted = *count;
    for (*count = 0; *count < wanted; ++*count) {
        StackEntry *entry = &entries[*count];
        GcError error = GCReadPort(port, entry->address, entry->buffer, &entry->size);
        if (error != GC_SUCCESS) return error;
    }
    return GC_SUCCESS;
}

GENTL_API GcError GCWritePortStacked(Handle port, StackEntry *entries, size_t *count)
{
    if (entries == NULL || count == NULL) return fail(GC_INVALID_PARAMETER, "no entries");
    size_t wanted = *count;
    for (*count = 0; *count < wanted; ++*count) {
        StackEntry *entry = &entries[*count];
        GcError error = GCWritePort(port, entry->address, entry->buffer, &entry->size);
        if (error != GC_SUCCESS) return error;
    }
    return GC_SUCCESS;
}

GENTL_API GcError GCGetNumPortURLs(Handle port, uint32_t *count)
{
    if (!is_port(port) || count == NULL) return fail(GC_INVALID_HANDLE, "invalid port");
    *count = 1;
    return GC_SUCCESS;
}

GENTL_API GcError GCGetPortURLInfo(Handle port, uint32_t index, int32_t what, GcType *type, void *buffer, size_t *size)
{
    if (!is_port(port)) return fail(GC_INVALID_HANDLE, "invalid port");
    if (index != 0) return fail(GC_INVALID_INDEX, "there is one URL");
    const Module *module = port;
    char text[128];
    switch (what) {
    case URL_URL:
        snprintf(text, sizeof text, "Local:slabcell_%s.xml;%" G_GINT64_MODIFIER "X;%zX", module->name,
                 (guint64) XML_ADDRESS, module->xml_size);
        return give_text(text, type, buffer, size);
    case URL_SCHEMA_MAJOR:
    case URL_SCHEMA_MINOR:
    case URL_FILE_MAJOR: return give_i32(1, type, buffer, size);
    case URL_FILE_MINOR:
    case URL_FILE_SUBMINOR:
    case URL_SCHEME: return give_i32(0, type, buffer, size);
    case URL_ADDRESS: return give_u64(XML_ADDRESS, type, buffer, size);
    case URL_SIZE: return give_u64(module->xml_size, type, buffer, size);
    case URL_FILENAME:
        snprintf(text, sizeof text, "slabcell_%s.xml", module->name);
        return give_text(text, type, buffer, size);
    default: return fail(GC_NOT_AVAILABLE, "URL information %d is not available", what);
    }
}

GENTL_API GcError GCGetPortURL(Handle port, char *url, size_t *size)
{
    return GCGetPortURLInfo(port, 0, URL_URL, NULL, url, size);
}

GENTL_API GcError GCGetPortInfo(Handle port, int32_t what, GcType *type, void *buffer, size_t *size)
{
    if (!is_port(port)) return fail(GC_INVALID_HANDLE, "invalid port");
    const Module *module = port;
    bool remote = module->kind == REMOTE;
    switch (what) {
    case PORT_ID:
    case PORT_NAME: return give_text(module->name, type, buffer, size);
    case PORT_VENDOR: return give_text(VENDOR, type, buffer, size);
    case PORT_MODEL: return give_text(MODEL, type, buffer, size);
    case PORT_TLTYPE: return give_text(TL_TYPE, type, buffer, size);
    case PORT_MODULE: return give_text(module->type, type, buffer, size);
    case PORT_LITTLE: return give_bool(!remote, type, buffer, size);
    case PORT_BIG: return give_bool(remote, type, buffer, size); /* GigE Vision registers are big-endian */
    case PORT_READ: return give_bool(true, type, buffer, size);
    case PORT_WRITE: return give_bool(remote, type, buffer, size);
    case PORT_NA:
    case PORT_NI: return give_bool(false, type, buffer, size);
    case PORT_VERSION: return give_text(VERSION, type, buffer, size);
    default: return fail(GC_NOT_AVAILABLE, "port information %d is not available", what);
    }
}
