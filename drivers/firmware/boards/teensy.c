/* Teensy 4.0 (i.MX RT1062) in a GTernal: its wiring, as github.com/robotarium/GTernal and its board's drawing have it.
 *
 * The line is that of its Raspberry Pi (Serial3). The bridge has an input of PWM and two of direction for each motor. Of
 * its sensors the battery is read; rfp has no place for the others, nor for its lamps.
 */
#include "cortex_m.h"

const char board_name[] = "teensy";

enum { UART_IRQ = 21, LEFT_IRQ = 81, RIGHT_IRQ = 86, TIMER_IRQ = 100 };

#define TICK_US 1000u
#define UART_HZ 24000000u

#define CCM 0x400FC000u
#define MUX 0x401F8000u
#define PADS 0x401F81F0u /* a pad's electrical settings, as far behind this as its function is behind MUX */
#define GPIO1 0x401B8000u
#define GPIO2 0x401BC000u
#define GPIO4 0x401C4000u
#define UART 0x40188000u
#define TIMER 0x401EC000u
#define WATCHDOG 0x400BC000u
#define PWM2 0x403E0000u
#define PWM4 0x403E8000u
#define FLEXSPI 0x402A8000u
#define ADC 0x400C4000u

#define REG16(address) (*(volatile uint16_t *)(address))

/* Registers of a port, behind its base. */
enum { DIRECTION = 0x04, LEVELS = 0x08, ALLOWED = 0x14, DUE = 0x18, BOTH_EDGES = 0x1C, SET = 0x84, CLEAR = 0x88 };

/* A pin: where its pad is set up, its port and its bit. Teensy's numbers of the pins stand at the right. */
struct pin {
    uint16_t pad;
    uint32_t port;
    uint8_t bit;
};

static const struct pin right_in1 = {0x0C8, GPIO1, 3};   /* 0 */
static const struct pin right_in2 = {0x0C4, GPIO1, 2};   /* 1 */
static const struct pin right_a = {0x024, GPIO4, 4};     /* 2 */
static const struct pin right_b = {0x028, GPIO4, 5};     /* 3 */
static const struct pin motors_on = {0x034, GPIO4, 8};   /* 5: of newer boards */
static const struct pin standby = {0x164, GPIO2, 10};    /* 6 */
static const struct pin left_in1 = {0x180, GPIO2, 17};   /* 7 */
static const struct pin left_in2 = {0x17C, GPIO2, 16};   /* 8 */
static const struct pin pi_off = {0x168, GPIO2, 11};     /* 9 */
static const struct pin left_b = {0x124, GPIO1, 26};     /* 20 */
static const struct pin left_a = {0x128, GPIO1, 27};     /* 21 */
enum { PAD_RIGHT_PWM = 0x02C, PAD_LEFT_PWM = 0x120, PAD_TX = 0x104, PAD_RX = 0x108, PAD_BATTERY = 0x11C }; /* 4 23 14 15 22 */

enum { OUTPUT = 0x38, PULLED_UP = 0x1F038 }; /* of a pad */
enum { AS_PWM = 1, AS_UART = 2, AS_GPIO = 5 };

static void use(uint32_t pad, uint32_t function, uint32_t electrical)
{
    REG(PADS + pad) = electrical;
    REG(MUX + pad) = function;
}

static void put(const struct pin *pin, bool level)
{
    REG(pin->port + (level ? SET : CLEAR)) = 1u << pin->bit;
}

static void start_output(const struct pin *pin)
{
    put(pin, false);
    REG(pin->port + DIRECTION) |= 1u << pin->bit;
    use(pin->pad, AS_GPIO, OUTPUT);
}

static void start_input(const struct pin *pin)
{
    use(pin->pad, AS_GPIO, PULLED_UP);
    REG(pin->port + BOTH_EDGES) |= 1u << pin->bit;
    REG(pin->port + ALLOWED) |= 1u << pin->bit;
}

/* --- Clocks. --- */

static void start_clocks(void)
{
    REG(CCM + 0x54u) &= ~3u;                                          /* waiting stops the core alone */
    REG(CCM + 0x1Cu) = (REG(CCM + 0x1Cu) & ~0x3Fu) | 1u << 6;         /* timers: crystal, 24 MHz */
    REG(CCM + 0x24u) = (REG(CCM + 0x24u) & ~0x3Fu) | 1u << 6;         /* UARTs: the same */
    REG(CCM + 0x68u) |= 3u << 28 | 3u << 30;                          /* LPUART2, GPIO2 */
    REG(CCM + 0x6Cu) |= 3u << 16 | 3u << 20 | 3u << 22 | 3u << 26;    /* ADC1, GPT1, GPIO1 */
    REG(CCM + 0x74u) |= 3u << 12;                                     /* GPIO4 */
    REG(CCM + 0x78u) |= 3u << 2 | 3u << 18 | 3u << 22;                /* pads, PWM2, PWM4 */
    REG(CCM + 0x7Cu) |= 3u << 4;                                      /* WDOG3 */
    REG(CCM + 0x80u) |= 3u << 10;                                     /* FlexSPI */
}

static void timer_isr(void)
{
    REG(TIMER + 0x08u) = 1u;
    REG(TIMER + 0x10u) = REG(TIMER + 0x24u) + TICK_US;
    __asm__ volatile("dsb"); /* it is cleared before this returns, or it comes again */
}

static void start_timer(void)
{
    REG(TIMER) = 0u;
    REG(TIMER + 0x04u) = UART_HZ / 1000000u - 1u;
    REG(TIMER) = 1u << 9 | 1u << 6 | 1u << 3 | 1u << 1;
    REG(TIMER) |= 1u;
    REG(TIMER + 0x0Cu) = 1u;
    timer_isr();
}

uint32_t board_now_us(void)
{
    return REG(TIMER + 0x24u);
}

/* --- Reset and watchdog. --- */

static uint8_t reset_cause;

static void read_reset_cause(void)
{
    const uint32_t causes = REG(0x400F8008u);

    REG(0x400F8008u) = causes;
    if ((causes & 1u << 7) != 0u) {
        reset_cause = RESET_WATCHDOG;
    } else {
        reset_cause = (causes & 1u) != 0u ? RESET_POWER_ON : RESET_EXTERNAL;
    }
}

uint8_t board_reset_cause(void)
{
    return reset_cause;
}

void board_watchdog_kick(void)
{
    REG(WATCHDOG + 0x04u) = 0xB480A602u;
}

static void start_watchdog(void)
{
    REG(WATCHDOG + 0x04u) = 0xD928C520u;
    while ((REG(WATCHDOG) & 1u << 11) == 0u) {
    }
    REG(WATCHDOG + 0x08u) = 32768u * 120u / 1000u;
    REG(WATCHDOG) = 1u << 13 | 1u << 8 | 1u << 7 | 1u << 1; /* it cannot be changed again until a reset */
    while ((REG(WATCHDOG) & 1u << 10) == 0u) {
    }
}

/* --- Encoders. --- */

static uint8_t pins_of(const struct pin *a, const struct pin *b)
{
    const uint32_t levels = REG(a->port + LEVELS);
    return (uint8_t)((levels >> a->bit & 1u) << 1 | (levels >> b->bit & 1u));
}

static void left_isr(void)
{
    REG(GPIO1 + DUE) = 0xFFFFFFFFu;
    encoder_edge(BOARD_LEFT, pins_of(&left_a, &left_b));
    __asm__ volatile("dsb");
}

static void right_isr(void)
{
    REG(GPIO4 + DUE) = 0xFFFFFFFFu;
    encoder_edge(BOARD_RIGHT, pins_of(&right_a, &right_b));
    __asm__ volatile("dsb");
}

/* --- Line. --- */

static void uart_isr(void)
{
    uint8_t byte;

    REG(UART + 0x14u) = REG(UART + 0x14u) | 1u << 20 | 1u << 19; /* idle, overrun */
    while ((REG(UART + 0x2Cu) >> 24 & 7u) > 0u) {
        line_received((uint8_t)REG(UART + 0x1Cu));
    }
    while ((REG(UART + 0x2Cu) >> 8 & 7u) < 4u) {
        if (!line_next(&byte)) {
            REG(UART + 0x18u) &= ~(1u << 23);
            __asm__ volatile("dsb");
            return;
        }
        REG(UART + 0x1Cu) = byte;
    }
    REG(UART + 0x18u) |= 1u << 23; /* when there is room again */
}

void board_send(void)
{
    interrupt_pend(UART_IRQ);
}

static void start_uart(void)
{
    use(PAD_TX, AS_UART, OUTPUT);
    use(PAD_RX, AS_UART, PULLED_UP);
    REG(0x401F852Cu) = 1u; /* its input is this pad */
    REG(0x401F8530u) = 1u;
    REG(UART + 0x18u) = 0u;
    REG(UART + 0x10u) = 15u << 24 | (UART_HZ / 8u / RFP_BAUD + 1u) / 2u; /* of 16 cycles, rounded */
    REG(UART + 0x28u) = 1u << 15 | 1u << 14 | 1u << 7 | 1u << 3;         /* empty queues of 4 bytes */
    REG(UART + 0x2Cu) = 1u << 16;                                        /* 2 bytes came */
    REG(UART + 0x18u) = 1u << 21 | 1u << 20 | 1u << 19 | 1u << 18;       /* or fewer, and then none */
}

/* --- Motors. --- */

static void set_duty(uint32_t pwm, uint32_t submodule, uint16_t duty)
{
    REG16(pwm + 0x188u) |= (uint16_t)(0x10u << submodule);
    REG16(pwm + 0x60u * submodule + 0x16u) = duty;
    REG16(pwm + 0x188u) |= (uint16_t)(1u << submodule);
}

static void start_pwm(uint32_t pwm, uint32_t submodule)
{
    const uint32_t base = pwm + 0x60u * submodule;

    REG16(pwm + 0x188u) |= (uint16_t)(0x10u << submodule);
    REG16(base + 0x04u) = 1u << 14 | 1u << 13;        /* each output by itself, also while the core waits */
    REG16(base + 0x06u) = 1u << 10 | 7u << 4;         /* bus clock / 128: about a kilohertz */
    REG16(base + 0x2Cu) = 0u;                         /* no input of faults */
    REG16(base + 0x02u) = 0u;
    REG16(base + 0x0Au) = 0u;
    REG16(base + 0x0Eu) = BOARD_FULL_DUTY - 1u;
    REG16(base + 0x12u) = 0u;
    REG16(base + 0x16u) = 0u;
    REG16(pwm + 0x180u) |= (uint16_t)(0x100u << submodule);
    REG16(pwm + 0x188u) |= (uint16_t)(0x101u << submodule);
}

/* `first` is high in one direction, `second` in the other one, both while it brakes. */
static void drive(const struct pin *first, const struct pin *second, int16_t duty)
{
    put(first, duty >= 0);
    put(second, duty <= 0);
}

void board_pwm(enum board_side side, int16_t duty)
{
    const uint16_t size = (uint16_t)(duty < 0 ? -duty : duty);

    if (side == BOARD_LEFT) {
        drive(&left_in2, &left_in1, duty);
        set_duty(PWM4, 1u, size);
    } else {
        drive(&right_in1, &right_in2, duty);
        set_duty(PWM2, 0u, size);
    }
}

void board_enable_motors(bool enabled)
{
    put(&standby, enabled);
    put(&motors_on, enabled);
}

/* --- Flash: sequences of its controller. --- */

#define FLASH_LOG 0x1F0000u
#define SEQUENCE(first, second) ((uint32_t)(second) << 16 | (uint32_t)(first))

enum { COMMAND = 1 << 10, ADDRESS = 2 << 10 | 24, WRITE = 8 << 10 | 4, READ = 9 << 10 | 4 }; /* on one wire */
enum { READ_WORD = 1, READ_STATUS, ALLOW_WRITE, PROGRAM, ERASE };                           /* their places */

static void start_flash(void)
{
    static const uint32_t sequences[ERASE + 1][2] = {
        [READ_WORD] = {SEQUENCE(COMMAND | 0x03, ADDRESS), READ},
        [READ_STATUS] = {SEQUENCE(COMMAND | 0x05, READ)},
        [ALLOW_WRITE] = {COMMAND | 0x06},
        [PROGRAM] = {SEQUENCE(COMMAND | 0x02, ADDRESS), WRITE},
        [ERASE] = {SEQUENCE(COMMAND | 0x20, ADDRESS)},
    };

    REG(FLEXSPI + 0x18u) = 0x5AF05AF0u;
    REG(FLEXSPI + 0x1Cu) = 2u;
    for (uint32_t k = READ_WORD; k <= ERASE; k++) {
        REG(FLEXSPI + 0x200u + 16u * k) = sequences[k][0];
        REG(FLEXSPI + 0x204u + 16u * k) = sequences[k][1];
        REG(FLEXSPI + 0x208u + 16u * k) = 0u;
        REG(FLEXSPI + 0x20Cu + 16u * k) = 0u;
    }
    while (flash_busy()) { /* with what was begun before a reset */
    }
}

static void begin(uint32_t sequence, uint32_t offset, uint32_t bytes)
{
    REG(FLEXSPI + 0xB8u) = 1u; /* empty queues */
    REG(FLEXSPI + 0xBCu) = 1u;
    REG(FLEXSPI + 0xA0u) = FLASH_LOG + offset;
    REG(FLEXSPI + 0xA4u) = sequence << 16 | bytes;
    REG(FLEXSPI + 0xB0u) = 1u;
}

static void finish(void)
{
    while ((REG(FLEXSPI + 0x14u) & 1u) == 0u) {
    }
    REG(FLEXSPI + 0x14u) = 1u;
}

bool flash_busy(void)
{
    begin(READ_STATUS, 0u, 1u);
    finish();
    return (REG(FLEXSPI + 0x100u) & 1u) != 0u;
}

uint32_t flash_read(uint32_t offset)
{
    begin(READ_WORD, offset, 4u);
    finish();
    return REG(FLEXSPI + 0x100u);
}

void flash_program(uint32_t offset, const uint32_t *words, uint32_t count)
{
    begin(ALLOW_WRITE, 0u, 0u);
    finish();
    begin(PROGRAM, offset, 4u * count);
    for (uint32_t k = 0u; k < count; k += 2u) {
        while ((REG(FLEXSPI + 0x14u) & 1u << 6) == 0u) { /* room for two words */
        }
        REG(FLEXSPI + 0x180u) = words[k];
        REG(FLEXSPI + 0x184u) = k + 1u < count ? words[k + 1u] : 0xFFFFFFFFu;
        REG(FLEXSPI + 0x14u) = 1u << 6;
    }
    finish();
}

void flash_erase(uint32_t offset)
{
    begin(ALLOW_WRITE, 0u, 0u);
    finish();
    begin(ERASE, offset, 0u);
    finish();
}

/* --- Battery, behind a divider; the rest this board does not measure. --- */

static uint16_t battery_mv;

uint16_t board_battery_mv(void)
{
    if ((REG(ADC + 0x20u) & 1u) != 0u) {
        battery_mv = (uint16_t)(REG(ADC + 0x24u) * 3300u * 20u / 15u / 4095u);
        REG(ADC) = 13u; /* the next one */
    }
    return battery_mv;
}

static void start_battery(void)
{
    use(PAD_BATTERY, AS_GPIO, 0u);
    REG(ADC + 0x44u) = 2u << 2 | 3u << 8 | 1u << 4 | 1u << 5 | 3u; /* 12 bits, slowly, by a clock of its own */
    REG(ADC) = 13u;
}

uint8_t board_faults(void)
{
    return 0;
}

int16_t board_current_ma(enum board_side side)
{
    (void)side;
    return 0;
}

/* --- Start. --- */

void board_begin(void)
{
    read_reset_cause();
    start_clocks();
    start_flash();
    start_watchdog();
    start_output(&standby);
    start_output(&motors_on);
    start_output(&pi_off);
    start_output(&left_in1);
    start_output(&left_in2);
    start_output(&right_in1);
    start_output(&right_in2);
    use(PAD_LEFT_PWM, AS_PWM, OUTPUT);
    use(PAD_RIGHT_PWM, AS_PWM, OUTPUT);
    start_pwm(PWM4, 1u);
    start_pwm(PWM2, 0u);
    board_pwm(BOARD_LEFT, 0);
    board_pwm(BOARD_RIGHT, 0);
    start_uart();
    start_battery();
    start_timer();
    start_input(&left_a);
    start_input(&left_b);
    start_input(&right_a);
    start_input(&right_b);
    encoder_pins[BOARD_LEFT] = pins_of(&left_a, &left_b);
    encoder_pins[BOARD_RIGHT] = pins_of(&right_a, &right_b);
    interrupt_enable(UART_IRQ);
    interrupt_enable(LEFT_IRQ);
    interrupt_enable(RIGHT_IRQ);
    interrupt_enable(TIMER_IRQ);
}

__attribute__((section(".vectors"), aligned(512), used)) const vector vectors[16 + TIMER_IRQ + 1] = {
    [3] = crashed,
    [16 + UART_IRQ] = uart_isr,
    [16 + LEFT_IRQ] = left_isr,
    [16 + RIGHT_IRQ] = right_isr,
    [16 + TIMER_IRQ] = timer_isr,
};

/* How the boot ROM reads the flash: at 30 MHz, on one wire. */
__attribute__((section(".flash_configuration"), used)) static const uint32_t flash_configuration[128] = {
    [0x000 / 4] = 0x42464346u,           /* "FCFB" */
    [0x004 / 4] = 0x56010000u,           /* version */
    [0x00C / 4] = 0x00030301u,           /* sampled by the loop of the pad; times of the chip select */
    [0x044 / 4] = 1u << 16 | 1u << 8 | 1u, /* 30 MHz, one wire, serial NOR */
    [0x050 / 4] = 2u * 1024u * 1024u,
    [0x080 / 4] = SEQUENCE(COMMAND | 0x03, ADDRESS),
    [0x084 / 4] = READ,
    [0x1C0 / 4] = 256u,
    [0x1C4 / 4] = FLASH_SECTOR_BYTES,
};

extern uint8_t image_bytes[];

static const void *const boot_data[3] __attribute__((section(".image_vector_table.data"))) = {
    (const void *)0x60000000u, image_bytes, 0};

__attribute__((section(".image_vector_table"), used)) static const void *const image_vector_table[8] = {
    (const void *)0x432000D1u, start, 0, 0, boot_data, image_vector_table, 0, 0};
