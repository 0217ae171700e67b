/* A robot of a host build: what its pins, its line and its memory hold. */
#ifndef ROBOFLEET_BOARD_HOST_H
#define ROBOFLEET_BOARD_HOST_H

#include "board.h"

#define HOST_LINE_BYTES 4096u
#define HOST_WRITE_LOOPS 2u /* that a byte of the memory takes */

struct host {
    uint32_t now_us;
    uint32_t call_us; /* that each look at the clock takes */
    uint8_t to_robot[HOST_LINE_BYTES];
    uint32_t arrived;  /* bytes in it */
    uint32_t received; /* of them, by the robot */
    uint8_t to_host[HOST_LINE_BYTES];
    uint32_t sent;     /* bytes in it; the program takes them, and sets 0 */
    int32_t counts[2];
    int16_t duty[2];
    uint8_t eeprom[BOARD_MEMORY_BYTES];
    uint8_t worn[BOARD_MEMORY_BYTES]; /* bits that cannot become 0 any more */
    int32_t writes_left; /* of the memory, until the power is cut */
    uint8_t writing;     /* loops until the memory is ready again */
    uint32_t kicks;      /* of the watchdog */
    uint8_t reset;
    uint8_t faults;
    uint16_t battery_mv;
    int16_t current_ma[2];
};

/* The robot that the following calls are about. */
void host_select(struct host *h);

#endif
