/* How is an answer given, and an error remembered?  GenTL's way: ask for the size first, the last error per thread. */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "producer.h"

static __thread GcError last_code = GC_SUCCESS;
static __thread char last_text[512] = "No error";

GcError fail(GcError code, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(last_text, sizeof last_text, format, arguments);
    va_end(arguments);
    last_code = code;
    return code;
}

GcError fail_with(GError *error, const char *what)
{
    GcError code = GC_IO;
    if (error == NULL) return fail(GC_ERROR, "%s", what);
    if (error->domain == ARV_DEVICE_ERROR) {
        if (error->code == ARV_DEVICE_ERROR_TIMEOUT) code = GC_TIMEOUT;
        else if (error->code == ARV_DEVICE_ERROR_NOT_CONTROLLER) code = GC_ACCESS_DENIED;
        else if (strstr(error->message, "access-denied") != NULL) code = GC_ACCESS_DENIED;
        else if (error->code == ARV_DEVICE_ERROR_NOT_FOUND) code = GC_INVALID_ID;
    }
    fail(code, "%s: %s", what, error->message);
    g_error_free(error);
    return code;
}

GcError give(GcType type, const void *value, size_t length, GcType *given_type, void *buffer, size_t *size)
{
    if (size == NULL) return fail(GC_INVALID_PARAMETER, "no place for the size");
    if (given_type != NULL) *given_type = type;
    if (buffer == NULL) {
        *size = length;
        return GC_SUCCESS;
    }
    if (*size < length) return fail(GC_BUFFER_TOO_SMALL, "%zu bytes are needed, %zu are there", length, *size);
    memcpy(buffer, value, length);
    *size = length;
    return GC_SUCCESS;
}

GcError give_text(const char *text, GcType *type, void *buffer, size_t *size)
{
    if (text == NULL) text = "";
    return give(TYPE_STRING, text, strlen(text) + 1, type, buffer, size);
}

#define GIVE(name, c_type, gentl_type)                                        \
    GcError name(c_type value, GcType *type, void *buffer, size_t *size)   \
    {                                                                         \
        return give(gentl_type, &value, sizeof value, type, buffer, size);    \
    }

GIVE(give_u64, uint64_t, TYPE_UINT64)
GIVE(give_size, size_t, TYPE_SIZET)
GIVE(give_i32, int32_t, TYPE_INT32)
GIVE(give_u32, uint32_t, TYPE_UINT32)
GIVE(give_pointer, void *, TYPE_PTR)

GcError give_bool(bool value, GcType *type, void *buffer, size_t *size)
{
    Bool8 byte = value ? 1 : 0;
    return give(TYPE_BOOL8, &byte, sizeof byte, type, buffer, size);
}

GENTL_API GcError GCGetLastError(GcError *code, char *text, size_t *size)
{
    if (code != NULL) *code = last_code;
    if (size == NULL) return GC_INVALID_PARAMETER;
    size_t length = strlen(last_text) + 1;
    if (text != NULL) {
        if (*size < length) return GC_BUFFER_TOO_SMALL;
        memcpy(text, last_text, length);
    }
    *size = length;
    return GC_SUCCESS;
}
