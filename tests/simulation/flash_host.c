/* A flash of two sectors whose power can fail in the middle of a write, for flash_log.c. */
#include "board.h"
#include "flash_log.h"

enum { SECTOR_WORDS = FLASH_SECTOR_BYTES / 4 };

uint32_t flash[2 * SECTOR_WORDS];
uint32_t worn[2 * SECTOR_WORDS]; /* bits that are 1 for ever */
uint32_t torn;                   /* bits that the last write did not reach */
int32_t words_left;              /* until the power fails */
uint32_t erased[2];              /* how often */
static uint32_t busy;

static bool fails(void)
{
    if (words_left <= 0) {
        return true;
    }
    words_left--;
    return false;
}

bool flash_busy(void)
{
    if (busy > 0u) {
        busy--;
    }
    return busy > 0u;
}

uint32_t flash_read(uint32_t offset)
{
    return flash[offset / 4u];
}

void flash_program(uint32_t offset, const uint32_t *words, uint32_t count)
{
    busy = 3u;
    for (uint32_t k = 0u; k < count && words_left > 0; k++) {
        uint32_t *word = &flash[offset / 4u + k];
        *word &= words[k] | worn[offset / 4u + k] | (fails() || words_left > 0 ? 0u : torn);
    }
}

void flash_erase(uint32_t offset)
{
    busy = 3u;
    erased[offset / FLASH_SECTOR_BYTES]++;
    if (words_left <= 0) {
        return;
    }
    const bool failed = fails() || words_left <= 0;
    for (uint32_t k = 0u; k < SECTOR_WORDS; k++) { /* one that fails has reached some cells, and the first word not */
        flash[offset / 4u + k] |= !failed ? 0xFFFFFFFFu : k % 2u == 0u ? 0u : torn;
    }
}

void board_watchdog_kick(void)
{
}
