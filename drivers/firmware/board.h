/* What a board must offer: one file of about a hundred lines in boards/. Nothing here waits. */
#ifndef ROBOFLEET_BOARD_H
#define ROBOFLEET_BOARD_H

#include <stdbool.h>
#include <stdint.h>

enum board_side { BOARD_LEFT = 0, BOARD_RIGHT = 1 };

/* Why the board started; bits. 0: unknown. */
enum board_reset { RESET_POWER_ON = 1, RESET_EXTERNAL = 2, RESET_BROWN_OUT = 4, RESET_WATCHDOG = 8 };

/* What is wrong with the robot; bits, those of RobotFault in robofleet/vehicles/interface.py. */
enum board_fault {
    FAULT_WIRED_STOP = 1,
    FAULT_BUMPED = 2,
    FAULT_CLIFF = 4,
    FAULT_WHEEL_DROPPED = 8,
    FAULT_OVERCURRENT = 16, /* robot.c sets it also for a wheel that does not turn though it is driven */
    FAULT_CHARGING = 32
};

#define BOARD_FULL_DUTY 1024
#define BOARD_MEMORY_BYTES 34u /* that memory.c uses, from address 0 on */

extern const char board_name[]; /* at most 12 characters: "uno" */

/* Time since the start [us]; it wraps. */
uint32_t board_now_us(void);

/* Take the next byte that arrived; returns whether there was one. The board buffers at least 64. */
bool board_uart_read(uint8_t *byte);

/* Send all of it, or nothing where the buffer has no room; returns whether it was taken. At least 64 bytes fit. */
bool board_uart_write(const uint8_t *bytes, uint8_t length);

/* Counts of a wheel's encoder since the start, forward +; they wrap. */
int32_t board_encoder(enum board_side side);

/* Drive a motor: -BOARD_FULL_DUTY to BOARD_FULL_DUTY, forward +. 0: brake. */
void board_pwm(enum board_side side, int16_t duty);

/* Bytes that outlast a loss of power. A write begins when it is called, and ends when ready; erased bytes are 0xFF. */
bool board_eeprom_ready(void);
uint8_t board_eeprom_read(uint8_t address);
void board_eeprom_write(uint8_t address, uint8_t value);

/* The microcontroller's own watchdog resets it 120 ms (or the next longer time it has) after the last call. */
void board_watchdog_kick(void);

/* Bits of enum board_reset, as at the start. */
uint8_t board_reset_cause(void);

/* Bits of enum board_fault, as felt now. */
uint8_t board_faults(void);

/* Battery [mV]; 0: not measured. */
uint16_t board_battery_mv(void);

/* Current of a motor [mA]; 0 where not measured. */
int16_t board_current_ma(enum board_side side);

#endif
