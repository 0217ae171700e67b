/* A board's memory as a log in flash, for boards that stand still while they erase it.
 *
 * A word of the log is a byte of the memory: address, value, and the complement of both; a torn one does not count. The
 * flash has two halves; the first word of each is its number, in the same way. Each start copies the bytes to the half
 * that is not the newest: it is erased before, and gets its number last. So nothing is erased while wheels may turn.
 */
#ifndef ROBOFLEET_FLASH_LOG_H
#define ROBOFLEET_FLASH_LOG_H

#include "board.h"

#define FLASH_LOG_WORDS 4096u /* of a half: for 240 latches in one run; each more is a worn memory (memory.c) */

/* A board's flash, in words of 4 bytes; an erased one is 0xFFFFFFFF. */
struct flash {
    uint32_t (*read)(uint32_t word);
    void (*write)(uint32_t word, uint32_t value);
    void (*erase)(uint32_t word); /* the half that begins there */
};

struct flash_log {
    const struct flash *flash;
    uint8_t bytes[BOARD_MEMORY_BYTES];
    uint32_t next; /* word that is written next */
    uint32_t end;
};

void flash_log_start(struct flash_log *l, const struct flash *flash);

/* As board_eeprom_read and board_eeprom_write. */
uint8_t flash_log_read(const struct flash_log *l, uint8_t address);
void flash_log_write(struct flash_log *l, uint8_t address, uint8_t value);

#endif
