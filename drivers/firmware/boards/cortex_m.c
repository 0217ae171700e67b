/* Start, line, encoders and memory of the boards with an ARM Cortex-M. */
#include "cortex_m.h"

#include <stddef.h>

/* --- Encoders. --- */

volatile uint8_t encoder_pins[2];
static volatile int32_t counts[2];

void encoder_edge(enum board_side side, uint8_t pins)
{
    static const int8_t steps[16] = {0, -1, 1, 0, 1, 0, 0, -1, -1, 0, 0, 1, 0, 1, -1, 0}; /* A is before B: forward */

    counts[side] += steps[encoder_pins[side] << 2 | pins];
    encoder_pins[side] = pins;
}

int32_t board_encoder(enum board_side side)
{
    return counts[side];
}

/* --- Line. --- */

struct ring {
    uint8_t bytes[256];
    volatile uint8_t in;
    volatile uint8_t out;
};

static struct ring received;
static struct ring sending;

void line_received(uint8_t byte)
{
    const uint8_t next = (uint8_t)(received.in + 1u);
    if (next != received.out) {
        received.bytes[received.in] = byte;
        received.in = next;
    }
}

bool line_next(uint8_t *byte)
{
    if (sending.out == sending.in) {
        return false;
    }
    *byte = sending.bytes[sending.out];
    sending.out = (uint8_t)(sending.out + 1u);
    return true;
}

bool board_uart_read(uint8_t *byte)
{
    if (received.out == received.in) {
        return false;
    }
    *byte = received.bytes[received.out];
    received.out = (uint8_t)(received.out + 1u);
    return true;
}

bool board_uart_write(const uint8_t *bytes, uint8_t length)
{
    uint8_t in = sending.in;
    if ((uint8_t)(sending.out - in - 1u) < length) {
        return false;
    }
    for (uint8_t k = 0u; k < length; k++) {
        sending.bytes[in] = bytes[k];
        in = (uint8_t)(in + 1u);
    }
    sending.in = in;
    board_send();
    return true;
}

/* --- Memory: a log in flash. ---
 *
 * A word of the log is a byte of the memory: address, value, and the complement of both. One that was torn does not
 * count. A sector's first word is its number in the same way; the higher one is valid. When it is full, all bytes go to
 * the other sector, that sector's number last, and it is erased. So a sector is erased once in a thousand written bytes
 * and at each start; it stands 100,000 of these.
 */

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
    return sector * (uint32_t)SECTOR_BYTES + word * 4u;
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

void memory_log_start(void)
{
    const uint32_t first = flash_read(offset_of(0u, 0u));
    const uint32_t second = flash_read(offset_of(1u, 0u));

    for (uint8_t k = 0u; k < BOARD_MEMORY_BYTES; k++) {
        log.bytes[k] = 0xFFu;
    }
    log.step = LOG_IDLE;
    log.stale = true;
    log.sector = is_whole(second) && (!is_whole(first) || (int16_t)(second - first) > 0) ? 1u : 0u;
    log.next = is_whole(first) || is_whole(second) ? 1u : SECTOR_WORDS; /* neither: the first start */
    while (log.next < SECTOR_WORDS) {
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
        memory_log_start(); /* what was copied is read again */
        if (log.next < SECTOR_WORDS) {
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
    if (log.next < SECTOR_WORDS) {
        append();
        return;
    }
    for (uint8_t k = 0u; k < BOARD_MEMORY_BYTES; k++) {
        copy[k] = guarded(k | (uint32_t)log.bytes[k] << 8);
    }
    log.step = LOG_COPYING;
    flash_program(offset_of(other_sector(), 1u), copy, BOARD_MEMORY_BYTES);
}

#ifdef __arm__
/* --- Start. --- */

extern uint32_t ram_begin[], ram_end[], ram_in_flash[], bss_end[]; /* of the linker script */

static void run(void)
{
    static struct robot robot;

    board_begin();
    memory_log_start();
    __asm__ volatile("cpsie i" ::: "memory");
    robot_start(&robot);
    board_enable_motors(true);
    for (;;) {
        robot_loop(&robot);
        if (received.out == received.in) {
            __asm__ volatile("wfe"); /* an interrupt since the last time ends it at once: no byte is slept over */
        }
    }
}

/* In flash: nothing of the program is in RAM yet. */
__attribute__((section(".start.code"), noreturn, used)) static void copy(void)
{
    for (uint32_t k = 0u; &ram_begin[k] < ram_end; k++) {
        ram_begin[k] = ram_in_flash[k];
    }
    for (uint32_t *word = ram_end; word < bss_end; word++) {
        *word = 0u;
    }
    REG(0xE000ED08u) = (uint32_t)vectors;
    __asm__ volatile("dsb\n isb" ::: "memory");
    void (*volatile in_ram)(void) = run;
    in_ram();
    __builtin_unreachable();
}

/* The first instructions. */
__attribute__((section(".start.first"), naked, used)) void start(void)
{
    __asm__ volatile("cpsid i\n ldr r0, =stack_end\n mov sp, r0\n ldr r0, =copy\n bx r0\n .ltorg");
}

void crashed(void)
{
    board_enable_motors(false);
    for (;;) { /* until the watchdog resets it */
    }
}

void interrupt_enable(uint32_t number)
{
    REG(0xE000E100u + number / 32u * 4u) = 1u << number % 32u;
}

void interrupt_pend(uint32_t number)
{
    REG(0xE000E200u + number / 32u * 4u) = 1u << number % 32u;
}

/* What a compiler may call without being told. */
void *memcpy(void *to, const void *from, size_t count);
void *memset(void *to, int value, size_t count);

void *memcpy(void *to, const void *from, size_t count)
{
    uint8_t *at = to;
    const uint8_t *byte = from;
    while (count-- > 0u) {
        *at++ = *byte++;
    }
    return to;
}

void *memset(void *to, int value, size_t count)
{
    uint8_t *at = to;
    while (count-- > 0u) {
        *at++ = (uint8_t)value;
    }
    return to;
}
#endif
