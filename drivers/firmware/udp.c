#include "udp.h"

#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include "rfp.h"

#define FROM_ROBOT 0x80u /* of a frame's head */

bool udp_open(struct udp *u, uint32_t address, uint16_t port)
{
    const struct sockaddr_in own = {
        .sin_family = AF_INET, .sin_port = htons(port), .sin_addr.s_addr = htonl(address)};

    *u = (struct udp){.descriptor = socket(AF_INET, SOCK_DGRAM, 0)};
    if (u->descriptor < 0) {
        return false;
    }
    if (bind(u->descriptor, (const struct sockaddr *)&own, sizeof own) != 0) {
        udp_close(u);
        return false;
    }
    return true;
}

/* Whether one of the bytes' frames is whole and a host's. */
static bool of_host(const uint8_t *bytes, uint8_t length)
{
    struct rfp_receiver r = {0};

    for (uint8_t k = 0u; k < length; k++) {
        if (rfp_receive(&r, bytes[k]) > 0u && (r.bytes[0] & FROM_ROBOT) == 0u) {
            return true;
        }
    }
    return false;
}

uint8_t udp_receive(struct udp *u, uint8_t *bytes, uint32_t now_us)
{
    struct sockaddr_in from = {0};
    socklen_t size = sizeof from;
    const ssize_t received =
        recvfrom(u->descriptor, bytes, UDP_BYTES - 1u, MSG_DONTWAIT, (struct sockaddr *)&from, &size);

    if (received < 0) {
        return 0u;
    }
    bytes[received] = 0u;
    const uint8_t length = (uint8_t)(received + 1);
    if (of_host(bytes, length)) {
        u->address = from.sin_addr.s_addr;
        u->port = from.sin_port;
        u->heard_us = now_us;
    }
    return length;
}

void udp_send(struct udp *u, const uint8_t *bytes, uint8_t length, uint32_t now_us)
{
    const struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = u->port, .sin_addr.s_addr = u->address};

    if (now_us - u->heard_us > UDP_SILENT_US) {
        u->port = 0u;
    }
    if (u->port != 0u) {
        (void)sendto(u->descriptor, bytes, length, MSG_DONTWAIT, (const struct sockaddr *)&to, sizeof to);
    }
}

void udp_close(struct udp *u)
{
    if (u->descriptor >= 0) {
        (void)close(u->descriptor);
    }
    u->descriptor = -1;
}
