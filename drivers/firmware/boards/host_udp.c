/* A robot as a process of this computer: PROGRAM PORT MEMORY. It listens at a UDP port of 127.0.0.1, in real time.
 *
 * MEMORY is a file that holds its struct host: it outlasts the process, as an EEPROM does, and who maps it sees the
 * pins. Its motors are of first order.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <netinet/in.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "../board_host.h"
#include "../config.h"
#include "../robot.h"
#include "../udp.h"

#define NO_LOAD_RAD_S 15.0 /* at BOARD_FULL_DUTY */
#define LAG_S 0.05
#define RAD_PER_TURN 6.283185307179586

static uint32_t now_us(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)((uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u);
}

static struct host *mapped(const char *path)
{
    const int file = open(path, O_RDWR | O_CREAT, 0600);
    const bool erased = file >= 0 && lseek(file, 0, SEEK_END) == 0;

    if (file < 0 || ftruncate(file, (off_t)sizeof(struct host)) != 0) {
        return NULL;
    }
    struct host *host = mmap(NULL, sizeof *host, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    (void)close(file);
    if (host == MAP_FAILED) {
        return NULL;
    }
    if (erased) {
        memset(host->eeprom, 0xFF, sizeof host->eeprom);
    }
    return host;
}

static void turn(struct host *host, double dt_s)
{
    static double speeds[2];
    static double angles[2];

    for (int side = 0; side < 2; side++) {
        speeds[side] += (NO_LOAD_RAD_S * host->duty[side] / BOARD_FULL_DUTY - speeds[side]) * dt_s / (LAG_S + dt_s);
        angles[side] += speeds[side] * dt_s;
        host->counts[side] = (int32_t)(angles[side] / RAD_PER_TURN * RFP_COUNTS_PER_TURN);
    }
}

int main(int argc, char **argv)
{
    static struct robot robot;
    struct udp udp;
    struct host *host = argc == 3 ? mapped(argv[2]) : NULL;

    if (host == NULL || !udp_open(&udp, INADDR_LOOPBACK, (uint16_t)atoi(argv[1]))) {
        fprintf(stderr, "usage: %s PORT MEMORY: a free UDP port, and a file that this user may write\n", argv[0]);
        return EXIT_FAILURE;
    }
    host->arrived = host->received = host->sent = 0u;
    host->duty[BOARD_LEFT] = host->duty[BOARD_RIGHT] = 0;
    host->counts[BOARD_LEFT] = host->counts[BOARD_RIGHT] = 0;
    host->writes_left = INT32_MAX;
    host->reset = RESET_POWER_ON;
    host->now_us = now_us();
    host_select(host);
    robot_start(&robot);
    for (;;) {
        struct pollfd line = {.fd = udp.descriptor, .events = POLLIN};
        const uint32_t before_us = host->now_us;

        if (host->received == host->arrived) {
            (void)poll(&line, 1, 1);
            host->received = 0u;
            host->arrived = udp_receive(&udp, host->to_robot, now_us());
        }
        host->now_us = now_us();
        turn(host, (host->now_us - before_us) * 1e-6);
        robot_loop(&robot);
        if (host->sent > 0u) { /* at most a frame a loop */
            udp_send(&udp, host->to_host, (uint8_t)host->sent, host->now_us);
            host->sent = 0u;
        }
    }
}
