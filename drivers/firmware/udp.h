/* A board's line on a network: frames in UDP datagrams, by BSD sockets (Linux, and lwIP on an ESP32). IPv4.
 *
 * A datagram of a host holds whole frames; one of the robot a single frame. The robot answers the host whose frame
 * came last, until that one has been silent for UDP_SILENT_US. Frames of robots are no host's: else two robots could
 * answer each other for ever.
 */
#ifndef ROBOFLEET_UDP_H
#define ROBOFLEET_UDP_H

#include <stdbool.h>
#include <stdint.h>

#define UDP_BYTES 128u /* of a datagram with its zero; the rest of a longer one is lost */
#define UDP_SILENT_US 1000000u

/* Begin with udp_open. */
struct udp {
    int descriptor;
    uint32_t address;  /* of the host that is answered, in the network's order */
    uint16_t port;     /* 0: there is none */
    uint32_t heard_us; /* when its newest frame came */
};

/* Listen at a port of an address, or of all (0); both in this computer's order. Returns whether they could be had. */
bool udp_open(struct udp *u, uint32_t address, uint16_t port);

/* Take the next datagram and a zero, which ends it. Returns how many of the UDP_BYTES are used; 0: there is none. */
uint8_t udp_receive(struct udp *u, uint8_t *bytes, uint32_t now_us);

/* Send a datagram. What the network does not take is lost, as on its way. */
void udp_send(struct udp *u, const uint8_t *bytes, uint8_t length, uint32_t now_us);

void udp_close(struct udp *u);

#endif
