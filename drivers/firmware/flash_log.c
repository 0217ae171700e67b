#include "flash_log.h"

#define ERASED UINT32_MAX

static uint32_t guarded(uint32_t low)
{
    return (low & 0xFFFFu) | ~low << 16;
}

static bool whole(uint32_t word)
{
    return ((word ^ word >> 16) & 0xFFFFu) == 0xFFFFu;
}

static void append(struct flash_log *l, uint8_t address, uint8_t value)
{
    l->flash->write(l->next, guarded(address | (uint32_t)value << 8));
    l->next++;
}

static void take(struct flash_log *l, uint32_t word)
{
    const uint8_t address = (uint8_t)word;
    if (whole(word) && address < BOARD_MEMORY_BYTES) {
        l->bytes[address] = (uint8_t)(word >> 8);
    }
}

void flash_log_start(struct flash_log *l, const struct flash *flash)
{
    const uint32_t first = flash->read(0u);
    const uint32_t second = flash->read(FLASH_LOG_WORDS);
    const bool second_is_newest = whole(second) && (!whole(first) || (int16_t)(second - first) > 0);
    const uint32_t from = second_is_newest ? FLASH_LOG_WORDS : 0u;
    const uint32_t to = FLASH_LOG_WORDS - from;
    const uint32_t number = flash->read(from);

    *l = (struct flash_log){.flash = flash, .next = to + 1u, .end = to + FLASH_LOG_WORDS};
    for (uint8_t k = 0u; k < BOARD_MEMORY_BYTES; k++) {
        l->bytes[k] = 0xFFu;
    }
    if (whole(number)) {
        for (uint32_t k = 1u; k < FLASH_LOG_WORDS && flash->read(from + k) != ERASED; k++) {
            take(l, flash->read(from + k));
        }
    }
    flash->erase(to);
    for (uint8_t k = 0u; k < BOARD_MEMORY_BYTES; k++) {
        append(l, k, l->bytes[k]);
    }
    flash->write(to, guarded(number + 1u));
}

uint8_t flash_log_read(const struct flash_log *l, uint8_t address)
{
    return l->bytes[address];
}

void flash_log_write(struct flash_log *l, uint8_t address, uint8_t value)
{
    if (l->next < l->end) {
        append(l, address, value);
        take(l, l->flash->read(l->next - 1u)); /* a word that is worn is not what was written: memory.c sees it */
    }
}
