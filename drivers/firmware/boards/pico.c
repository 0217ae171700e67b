/* Raspberry Pi Pico (RP2040) with a bridge of two inputs a motor and two quadrature encoders (README.md says which pins).
 *
 * At 125 MHz, from the crystal. The line is UART0: one over the chip's own USB would die with the program that serves it.
 */
#include "cortex_m.h"

const char board_name[] = "pico";

enum { /* pins */
    PIN_TX = 0,
    PIN_RX = 1,
    PIN_LEFT = 2, /* and the next one */
    PIN_RIGHT = 6,
    PIN_ENABLE = 8,
    PIN_LEFT_A = 10, /* 11: B; 12, 13: of the right encoder */
    PIN_RIGHT_A = 12,
    PIN_RIGHT_B = 13
};
enum { FUNCTION_UART = 2, FUNCTION_PWM = 4, FUNCTION_SIO = 5 };
enum { TIMER_IRQ = 0, PINS_IRQ = 13, UART_IRQ = 20 };

#define SYS_HZ 125000000u
#define TICK_US 1000u

/* A register's bits are set and cleared at two addresses of their own. */
#define SET(address) REG((address) + 0x2000u)
#define CLEAR(address) REG((address) + 0x3000u)

#define RESETS 0x4000C000u
#define CLOCKS 0x40008000u
#define XOSC 0x40024000u
#define PLL 0x40028000u
#define PINS 0x40014000u
#define PADS 0x4001C000u
#define SIO 0xD0000000u
#define UART 0x40034000u
#define PWM 0x40050000u
#define TIMER 0x40054000u
#define WATCHDOG 0x40058000u

/* --- Clocks. --- */

static void release(uint32_t blocks)
{
    CLEAR(RESETS) = blocks;
    while ((~REG(RESETS + 0x08u) & blocks) != 0u) {
    }
}

static void start_clocks(void)
{
    REG(XOSC) = 0xAA0u;
    REG(XOSC + 0x0Cu) = 47u; /* it has a millisecond to begin */
    SET(XOSC) = 0xFABu << 12;
    while ((REG(XOSC + 0x04u) & 1u << 31) == 0u) {
    }
    REG(CLOCKS + 0x30u) = 2u; /* clk_ref: crystal, 12 MHz */
    while ((REG(CLOCKS + 0x38u) & 1u << 2) == 0u) {
    }
    release(1u << 12);
    REG(PLL + 0x08u) = 125u; /* 12 MHz * 125 / 6 / 2 */
    CLEAR(PLL + 0x04u) = 1u << 5 | 1u << 0;
    while ((REG(PLL) & 1u << 31) == 0u) {
    }
    REG(PLL + 0x0Cu) = 6u << 16 | 2u << 12;
    CLEAR(PLL + 0x04u) = 1u << 3;
    REG(CLOCKS + 0x3Cu) = 0u;
    REG(CLOCKS + 0x3Cu) = 1u; /* clk_sys: PLL */
    while ((REG(CLOCKS + 0x44u) & 1u << 1) == 0u) {
    }
    REG(CLOCKS + 0x48u) = 1u << 11; /* clk_peri: clk_sys */
    REG(WATCHDOG + 0x2Cu) = 1u << 9 | 12u; /* a microsecond, for watchdog and timer */
}

static void timer_isr(void)
{
    REG(TIMER + 0x34u) = 1u;
    REG(TIMER + 0x10u) = REG(TIMER + 0x28u) + TICK_US;
}

uint32_t board_now_us(void)
{
    return REG(TIMER + 0x28u);
}

/* --- Reset and watchdog. --- */

uint8_t board_reset_cause(void)
{
    const uint32_t chip = REG(0x40064008u);

    if (REG(WATCHDOG + 0x08u) != 0u) {
        return RESET_WATCHDOG;
    }
    return (chip & 1u << 8) != 0u ? RESET_POWER_ON : RESET_EXTERNAL; /* of too little voltage: as of power-on */
}

void board_watchdog_kick(void)
{
    REG(WATCHDOG + 0x04u) = 2u * 120000u; /* it counts down by two in a microsecond (RP2040-E1) */
}

/* --- Encoders. --- */

static uint8_t pins_of(uint32_t levels, uint32_t a)
{
    return (uint8_t)((levels >> a & 1u) << 1 | (levels >> a >> 1 & 1u));
}

static void pins_isr(void)
{
    REG(PINS + 0xF4u) = 0xFFFFFFFFu; /* before they are read: no edge is missed */
    const uint32_t levels = REG(SIO + 0x04u);
    encoder_edge(BOARD_LEFT, pins_of(levels, PIN_LEFT_A));
    encoder_edge(BOARD_RIGHT, pins_of(levels, PIN_RIGHT_A));
}

/* --- Line. --- */

static void uart_isr(void)
{
    uint8_t byte;

    while ((REG(UART + 0x18u) & 1u << 4) == 0u) {
        line_received((uint8_t)REG(UART));
    }
    while ((REG(UART + 0x18u) & 1u << 5) == 0u) {
        if (!line_next(&byte)) {
            CLEAR(UART + 0x38u) = 1u << 5;
            return;
        }
        REG(UART) = byte;
    }
    SET(UART + 0x38u) = 1u << 5; /* when there is room again */
}

void board_send(void)
{
    interrupt_pend(UART_IRQ);
}

static void start_uart(void)
{
    const uint32_t divisor = (4u * SYS_HZ + RFP_BAUD / 2u) / RFP_BAUD; /* of 16 cycles, in 64ths */

    REG(UART + 0x24u) = divisor >> 6;
    REG(UART + 0x28u) = divisor & 63u;
    REG(UART + 0x2Cu) = 3u << 5 | 1u << 4; /* 8N1, with queues */
    REG(UART + 0x34u) = 0u;                /* 4 bytes came */
    REG(UART + 0x30u) = 1u << 9 | 1u << 8 | 1u << 0;
    REG(UART + 0x38u) = 1u << 6 | 1u << 4; /* or fewer, and then none */
}

/* --- Motors: one input is high, the other one low for as long as the motor drives. Else both are high: it brakes. --- */

void board_pwm(enum board_side side, int16_t duty)
{
    const uint32_t slice = side == BOARD_LEFT ? 1u : 3u;
    const uint32_t first = BOARD_FULL_DUTY - (uint32_t)(duty < 0 ? -duty : 0);
    const uint32_t second = BOARD_FULL_DUTY - (uint32_t)(duty > 0 ? duty : 0);

    REG(PWM + 0x14u * slice + 0x0Cu) = second << 16 | first;
}

static void start_pwm(uint32_t slice)
{
    REG(PWM + 0x14u * slice + 0x04u) = SYS_HZ / BOARD_FULL_DUTY / 1000u << 4; /* 1 kHz */
    REG(PWM + 0x14u * slice + 0x10u) = BOARD_FULL_DUTY - 1u;
    REG(PWM + 0x14u * slice) = 1u;
}

void board_enable_motors(bool enabled)
{
    REG(SIO + (enabled ? 0x14u : 0x18u)) = 1u << PIN_ENABLE;
}

/* --- Flash, by its commands: the program does not stand in it. --- */

#define SSI 0x18000000u
#define FLASH_LOG (2u * 1024u * 1024u - 2u * FLASH_SECTOR_BYTES)

static void select(bool on)
{
    REG(0x4001800Cu) = (on ? 2u : 3u) << 8; /* its chip select, low or high */
}

static uint8_t shift(uint32_t byte)
{
    REG(SSI + 0x60u) = byte;
    while ((REG(SSI + 0x28u) & 1u << 3) == 0u) {
    }
    return (uint8_t)REG(SSI + 0x60u);
}

static void command(uint32_t code, uint32_t offset)
{
    const uint32_t address = FLASH_LOG + offset;

    select(true);
    shift(code);
    shift(address >> 16 & 0xFFu);
    shift(address >> 8 & 0xFFu);
    shift(address & 0xFFu);
}

static void allow_write(void)
{
    select(true);
    shift(0x06u);
    select(false);
}

bool flash_busy(void)
{
    select(true);
    shift(0x05u);
    const uint8_t status = shift(0u);
    select(false);
    return (status & 1u) != 0u;
}

uint32_t flash_read(uint32_t offset)
{
    uint32_t word = 0u;

    command(0x03u, offset);
    for (uint32_t k = 0u; k < 4u; k++) {
        word |= (uint32_t)shift(0u) << 8u * k;
    }
    select(false);
    return word;
}

void flash_program(uint32_t offset, const uint32_t *words, uint32_t count)
{
    allow_write();
    command(0x02u, offset);
    for (uint32_t k = 0u; k < 4u * count; k++) {
        shift(words[k / 4u] >> 8u * (k % 4u) & 0xFFu);
    }
    select(false);
}

void flash_erase(uint32_t offset)
{
    allow_write();
    command(0x20u, offset);
    select(false);
}

static void start_flash(void)
{
    select(false);
    REG(SSI + 0x08u) = 0u;
    REG(SSI + 0x14u) = 8u;       /* 15.6 MHz */
    REG(SSI + 0x00u) = 7u << 16; /* bytes, both ways */
    REG(SSI + 0x10u) = 1u;
    REG(SSI + 0x08u) = 1u;
    while (flash_busy()) { /* with what was begun before a reset */
    }
}

/* --- What this wiring does not have. --- */

uint8_t board_faults(void)
{
    return 0;
}

uint16_t board_battery_mv(void)
{
    return 0;
}

int16_t board_current_ma(enum board_side side)
{
    (void)side;
    return 0;
}

/* --- Start. --- */

static void use(uint32_t pin, uint32_t function)
{
    REG(PINS + 8u * pin + 4u) = function;
}

void board_begin(void)
{
    start_clocks();
    release(1u << 5 | 1u << 8 | 1u << 14 | 1u << 21 | 1u << 22); /* pins, pads, PWM, timer, UART */
    start_flash();
    REG(0x40010008u) = 0x1FFFCu; /* what the watchdog resets: all but the oscillators */
    board_watchdog_kick();
    REG(WATCHDOG) = 1u << 30;

    REG(SIO + 0x24u) = 1u << PIN_ENABLE; /* an output, low */
    use(PIN_ENABLE, FUNCTION_SIO);
    start_pwm(1u);
    start_pwm(3u);
    board_pwm(BOARD_LEFT, 0);
    board_pwm(BOARD_RIGHT, 0);
    for (uint32_t k = 0u; k < 2u; k++) {
        use(PIN_LEFT + k, FUNCTION_PWM);
        use(PIN_RIGHT + k, FUNCTION_PWM);
    }

    for (uint32_t pin = PIN_LEFT_A; pin <= PIN_RIGHT_B; pin++) {
        REG(PADS + 4u + 4u * pin) = 0x5Au; /* an input with a pull-up */
        use(pin, FUNCTION_SIO);
    }
    REG(PADS + 4u + 4u * PIN_RX) = 0x5Au;
    use(PIN_TX, FUNCTION_UART);
    use(PIN_RX, FUNCTION_UART);
    start_uart();

    pins_isr();
    REG(PINS + 0x104u) = 0x00CCCC00u; /* both edges of pins 10 to 13 */
    REG(TIMER + 0x38u) = 1u;
    timer_isr();
    interrupt_enable(TIMER_IRQ);
    interrupt_enable(PINS_IRQ);
    interrupt_enable(UART_IRQ);
}

__attribute__((section(".vectors"), aligned(256), used)) const vector vectors[16 + 26] = {
    [3] = crashed,
    [16 + TIMER_IRQ] = timer_isr,
    [16 + PINS_IRQ] = pins_isr,
    [16 + UART_IRQ] = uart_isr,
};
