#include "flash_log.h"

#include "board.h"

enum { WORDS = FLASH_SECTOR_BYTES / 4 };
enum log_step { LOG_IDLE, LOG_APPENDING, LOG_COPYING, LOG_NUMBERING, LOG_ERASING }; /* what the flash does */

static struct {
    uint8_t bytes[BOARD_MEMORY_BYTES];
    uint8_t sector;   /* the valid one */
    bool stale;       /* the other one is to be erased */
    uint16_t next;    /* free word in it */
    uint32_t word;    /* that is being appended */
    enum log_step step;
} log;

static uint32_t guarded(uint32_t half)
{
    return half | ~half << 16;
}

static bool is_whole(uint32_t word)
{
    return word == guarded(word & 0xFFFFu);
}

static uint32_t offset_of(uint8_t sector, uint16_t word)
{
    return sector * (uint32_t)FLASH_SECTOR_BYTES + word * 4u;
}

static uint8_t other_sector(void)
{
    return (uint8_t)(1u - log.sector);
}

static void take_word(uint32_t word)
{
    if (is_whole(word) && (word & 0xFFu) < BOARD_MEMORY_BYTES) {
        log.bytes[word & 0xFFu] = (uint8_t)(word >> 8);
    }
}

void flash_log_start(void)
{
    const uint32_t first = flash_read(offset_of(0u, 0u));
    const uint32_t second = flash_read(offset_of(1u, 0u));

    for (uint8_t k = 0u; k < BOARD_MEMORY_BYTES; k++) {
        log.bytes[k] = 0xFFu;
    }
    log.step = LOG_IDLE;
    log.stale = true;
    log.sector = is_whole(second) && (!is_whole(first) || (int16_t)(second - first) > 0) ? 1u : 0u;
    log.next = is_whole(first) || is_whole(second) ? 1u : WORDS; /* neither: the first start */
    while (log.next < WORDS) {
        const uint32_t word = flash_read(offset_of(log.sector, log.next));
        if (word == 0xFFFFFFFFu) {
            break;
        }
        take_word(word);
        log.next++;
    }
}

static void append(void)
{
    log.step = LOG_APPENDING;
    flash_program(offset_of(log.sector, log.next), &log.word, 1u);
}

bool board_eeprom_ready(void)
{
    if (log.step != LOG_IDLE && flash_busy()) {
        return false;
    }
    if (log.step == LOG_COPYING) {
        const uint32_t number = guarded((flash_read(offset_of(log.sector, 0u)) + 1u) & 0xFFFFu);
        log.step = LOG_NUMBERING;
        flash_program(offset_of(other_sector(), 0u), &number, 1u);
        return false;
    }
    if (log.step == LOG_NUMBERING) {
        flash_log_start(); /* what was copied is read again */
        if (log.next < WORDS) {
            append();
            return false;
        }
    }
    if (log.step == LOG_APPENDING) { /* a worn word is not what was written: memory.c sees it */
        take_word(flash_read(offset_of(log.sector, log.next)));
        log.next++;
    }
    if (log.stale) {
        log.stale = false;
        log.step = LOG_ERASING;
        flash_erase(offset_of(other_sector(), 0u));
        return false;
    }
    log.step = LOG_IDLE;
    return true;
}

uint8_t board_eeprom_read(uint8_t address)
{
    return log.bytes[address];
}

void board_eeprom_write(uint8_t address, uint8_t value)
{
    uint32_t copy[BOARD_MEMORY_BYTES];

    log.word = guarded(address | (uint32_t)value << 8);
    if (log.next < WORDS) {
        append();
        return;
    }
    for (uint8_t k = 0u; k < BOARD_MEMORY_BYTES; k++) {
        copy[k] = guarded(k | (uint32_t)log.bytes[k] << 8);
    }
    log.step = LOG_COPYING;
    flash_program(offset_of(other_sector(), 1u), copy, BOARD_MEMORY_BYTES);
}
