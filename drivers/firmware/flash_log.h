/* board_eeprom_* as a log in flash, for boards that have flash only (flash_log.c); and what such a board gives to it.
 *
 * A word of the log is a byte of the memory: address, value, and the complement of both. One that was torn does not
 * count. A sector's first word is its number in the same way; the higher one is valid. When it is full, all bytes go to
 * the other sector, that sector's number last, and it is erased. So a sector is erased once in a thousand written bytes
 * and at each start; it stands 100,000 of these.
 */
#ifndef ROBOFLEET_FLASH_LOG_H
#define ROBOFLEET_FLASH_LOG_H

#include <stdbool.h>
#include <stdint.h>

#ifndef FLASH_SECTOR_BYTES
#define FLASH_SECTOR_BYTES 4096
#endif

/* --- From the board. --- */

/* A flash of two sectors; offsets in bytes. Programming (a page of 256 bytes at most) and erasing begin, and end when
 * it is not busy any more. */
bool flash_busy(void);
uint32_t flash_read(uint32_t offset);
void flash_program(uint32_t offset, const uint32_t *words, uint32_t count);
void flash_erase(uint32_t offset);

/* --- For the board. --- */

/* Read the log; before board_eeprom_*. */
void flash_log_start(void);

#endif
