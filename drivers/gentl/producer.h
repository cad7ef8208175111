/* What do the parts of the producer share?  The modules of GenTL as structs, one lock, and how an answer is given. */
#ifndef SLABCELL_GENTL_PRODUCER_H
#define SLABCELL_GENTL_PRODUCER_H

#include <arv.h>
#include <stdbool.h>

#include "abi.h"

#define TL_TYPE "GEV"
#define VENDOR "slabcell"
#define MODEL "Aravis GenTL producer"
#define VERSION "1.0"
#define INTERFACE_ID "aravis-gev"
#define STREAM_ID "stream0"

typedef enum { SYSTEM = 0x51AB0001, INTERFACE, DEVICE, REMOTE, STREAM, EVENT } Kind;

/* Every handle points to a module; its first member says which, so that a wrong handle is refused. */
typedef struct Module {
    Kind kind;
    const char *name;   /* of the port */
    const char *type;   /* TLSystem, TLInterface, ... */
    const char *xml;    /* of the port's features */
    size_t xml_size;
} Module;

typedef struct Buffer {
    ArvBuffer *arv;
    void *base;
    size_t size;
    void *user;
    bool queued;
    bool delivered;
} Buffer;

typedef struct Device Device;

typedef struct {
    Module module;
    Device *device;
    ArvStream *stream; /* NULL while not acquiring */
    GPtrArray *buffers;
    GMutex lock;       /* guards stream and buffers */
    struct Event *event;
    uint64_t delivered;
    uint64_t started;
} Stream;

typedef struct Event {
    Module module;
    Stream *stream;
    volatile gint killed;
    uint64_t fired;
} Event;

struct Device {
    Module module;
    Module remote;
    ArvDevice *arv;
    Stream *stream;
    char *id;
};

/* errors */
GcError fail(GcError code, const char *format, ...) G_GNUC_PRINTF(2, 3);
GcError fail_with(GError *error, const char *what);

/* answers: the type, then either the size needed or the value */
GcError give(GcType type, const void *value, size_t length, GcType *given_type, void *buffer, size_t *size);
GcError give_text(const char *text, GcType *type, void *buffer, size_t *size);
GcError give_u64(uint64_t value, GcType *type, void *buffer, size_t *size);
GcError give_size(size_t value, GcType *type, void *buffer, size_t *size);
GcError give_i32(int32_t value, GcType *type, void *buffer, size_t *size);
GcError give_u32(uint32_t value, GcType *type, void *buffer, size_t *size);
GcError give_bool(bool value, GcType *type, void *buffer, size_t *size);
GcError give_pointer(void *value, GcType *type, void *buffer, size_t *size);

void module_init(Module *module, Kind kind, const char *name, const char *type);
bool is_a(const void *handle, Kind kind);

Device *device_open(const char *address, bool control, GcError *error);
void stream_free(Stream *stream);

/* buffers; with the stream's lock held */
Buffer *stream_match(Stream *stream, ArvBuffer *arv);
void stream_push(Stream *stream, Buffer *buffer);
void stream_discard_filled(Stream *stream);

/* cameras that answer a discovery */
typedef struct {
    char *id;      /* the camera's IPv4 address: stable, and quick to open */
    char *vendor;
    char *model;
    char *serial;
} Found;

GPtrArray *discover(void); /* of Found; the caller frees it */

#define REQUIRE(handle, kind)                                                             \
    do {                                                                                  \
        if (!is_a((handle), (kind))) return fail(GC_INVALID_HANDLE, "invalid handle"); \
    } while (0)

#endif
