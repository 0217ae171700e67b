/* Start, line and encoders of the boards with an ARM Cortex-M. */
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

/* --- Start. --- */

extern uint32_t ram_begin[], ram_end[], ram_in_flash[], bss_end[]; /* of the linker script */

static void run(void)
{
    static struct robot robot;

    board_begin();
    flash_log_start();
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
