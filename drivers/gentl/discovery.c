/* Which cameras answer?  All that Aravis finds by broadcast; or those at given addresses, asked one by one.
 *
 * Aravis listens for a whole second, which is long when one camera comes back.  A consumer that knows where its cameras are
 * names them in the environment: SLABCELL_GENTL_ADDRESSES=192.168.10.5,192.168.10.6
 *
 * Source: GigE Vision 1.2, DISCOVERY_CMD and DISCOVERY_ACK.
 */
#include <string.h>

#include "producer.h"

#define ADDRESSES "SLABCELL_GENTL_ADDRESSES"
#define GVCP_PORT 3956
#define ASKED_TIMES 5
#define PATIENCE_US 100000
#define ANSWER_BYTES 256 /* header and the first bootstrap registers */
#define HEADER_BYTES 8

/* DISCOVERY_CMD, wants an answer, no body, request 1. */
static const char QUESTION[HEADER_BYTES] = {0x42, 0x01, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01};
/* DISCOVERY_ACK: status success, command, length, request. */
static const char ANSWER[HEADER_BYTES] = {0x00, 0x00, 0x00, 0x03, 0x00, (char) 0xF8, 0x00, 0x01};

static void free_found(gpointer pointer)
{
    Found *found = pointer;
    g_free(found->id);
    g_free(found->vendor);
    g_free(found->model);
    g_free(found->serial);
    g_free(found);
}

static Found *found_new(const char *id, const char *vendor, const char *model, const char *serial)
{
    Found *found = g_new0(Found, 1);
    found->id = g_strdup(id);
    found->vendor = g_strdup(vendor);
    found->model = g_strdup(model);
    found->serial = g_strdup(serial);
    return found;
}

/* Returns the text of a register that need not end with a zero. */
static char *text(const char *answer, size_t address, size_t size)
{
    char *raw = g_strndup(answer + HEADER_BYTES + address, size);
    char *valid = g_utf8_make_valid(raw, -1);
    g_free(raw);
    return valid;
}

/* Asks again until an answer comes: a packet may be lost, and a port that nobody listens at answers with an error. */
static gssize ask(GSocket *port, char *answer, size_t size)
{
    for (int i = 0; i < ASKED_TIMES; i++) {
        g_socket_send(port, QUESTION, HEADER_BYTES, NULL, NULL);
        if (!g_socket_condition_timed_wait(port, G_IO_IN, PATIENCE_US, NULL, NULL)) continue;
        gssize got = g_socket_receive(port, answer, size, NULL, NULL);
        if (got >= ANSWER_BYTES && memcmp(answer, ANSWER, HEADER_BYTES) == 0) return got;
    }
    return -1;
}

static Found *found_at(const char *id)
{
    GInetAddress *host = g_inet_address_new_from_string(id);
    if (host == NULL) return NULL;
    GSocketAddress *place = g_inet_socket_address_new(host, GVCP_PORT);
    GSocket *port = g_socket_new(g_inet_address_get_family(host), G_SOCKET_TYPE_DATAGRAM, G_SOCKET_PROTOCOL_UDP, NULL);
    Found *found = NULL;
    char answer[1024];
    if (port != NULL && g_socket_connect(port, place, NULL, NULL) && ask(port, answer, sizeof answer) > 0) {
        char *vendor = text(answer, 0x48, 32), *model = text(answer, 0x68, 32), *serial = text(answer, 0xD8, 16);
        found = found_new(id, vendor, model, serial);
        g_free(vendor);
        g_free(model);
        g_free(serial);
    }
    g_clear_object(&port);
    g_object_unref(place);
    g_object_unref(host);
    return found;
}

static void ask_addresses(const char *list, GPtrArray *seen)
{
    char **addresses = g_strsplit(list, ",", -1);
    for (char **address = addresses; *address != NULL; address++) {
        Found *found = found_at(g_strstrip(*address));
        if (found != NULL) g_ptr_array_add(seen, found);
    }
    g_strfreev(addresses);
}

static void ask_everybody(GPtrArray *seen)
{
    arv_update_device_list();
    for (guint i = 0; i < arv_get_n_devices(); i++) {
        if (g_strcmp0(arv_get_device_protocol(i), "GigEVision") != 0) continue;
        g_ptr_array_add(seen, found_new(arv_get_device_address(i), arv_get_device_vendor(i), arv_get_device_model(i),
                                        arv_get_device_serial_nbr(i)));
    }
}

GPtrArray *discover(void)
{
    GPtrArray *seen = g_ptr_array_new_with_free_func(free_found);
    const char *list = g_getenv(ADDRESSES);
    if (list != NULL && *list != '\0')
        ask_addresses(list, seen);
    else
        ask_everybody(seen);
    return seen;
}
