/* What the boards with an ARM Cortex-M share (cortex_m.c), and what each of them gives to it.
 *
 * The whole program is copied to RAM before it begins. So writing the flash stops nothing: neither the loop, nor an
 * encoder's interrupts, nor the line's.
 */
#ifndef ROBOFLEET_CORTEX_M_H
#define ROBOFLEET_CORTEX_M_H

#include "../config.h"
#include "../flash_log.h"
#include "../robot.h"

#define REG(address) (*(volatile uint32_t *)(address))

typedef void (*vector)(void);

/* --- From the board. --- */

/* Clocks, pins with the motors off, encoders' and line's interrupts, flash, watchdog. */
void board_begin(void);

/* The bridge may drive, or not. */
void board_enable_motors(bool enabled);

/* `line_next` has bytes: let the line's interrupt come. */
void board_send(void);

/* The interrupts, the core's first. One of them comes every millisecond. */
extern const vector vectors[];

/* --- For the board. --- */

extern volatile uint8_t encoder_pins[2]; /* A << 1 | B, as seen last */

/* An interrupt of an encoder: each edge counts. */
void encoder_edge(enum board_side side, uint8_t pins);

/* An interrupt of the line: a byte came; which byte is to be sent, if there is one. */
void line_received(uint8_t byte);
bool line_next(uint8_t *byte);

/* Let an interrupt of the core's controller come when it is due; let it come now. */
void interrupt_enable(uint32_t number);
void interrupt_pend(uint32_t number);

/* The first instructions; where a boot loader goes on. */
void start(void);

/* A vector: the program is broken. The motors are off until the watchdog resets the board. */
void crashed(void);

#endif
