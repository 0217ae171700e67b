/* An Arduino with ros_arduino_bridge's wiring around simavr's ATmega: UART, bridges, two quadrature encoders, EEPROM.
 *
 * board.py compiles it against libsimavr. Times are cycles of the microcontroller (16 MHz).
 */
#include <simavr/avr_eeprom.h>
#include <simavr/avr_extint.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <simavr/sim_io.h>
#include <stdlib.h>
#include <string.h>

DEFINE_FIFO(uint16_t, uart_fifo);

enum { LINE_BYTES = 4096, UART_DEPTH = 2, MCUSR = 0x54, PORF = 1, BORF = 4, SET_ON_MATCH = 3 };
enum { EEPROM_BYTES = 1024, EECR = 0x3f, EEPE = 2, EEARL = 0x41, EEARH = 0x42, EEPROM_CYCLES = 54400 /* 3.4 ms */ };

struct pin {
    char port;
    uint8_t bit;
    uint16_t ddr, out;                   /* addresses of its direction and level */
    uint16_t tccr, ocr, shift;           /* its timer's mode, its compare register, where its mode's bits stand */
};

struct wheel {
    struct pin forward, backward, enable, a, b;
};

struct wiring {
    const char *mcu;
    struct wheel wheels[2];              /* left, right */
};

static const struct wiring wirings[] = {
    {"atmega328p", {                     /* Uno: pins 10, 6, 13, 2, 3; 9, 5, 12, A4, A5 */
        {{'B', 2, 0x24, 0x25, 0x80, 0x8a, 4}, {'D', 6, 0x2a, 0x2b, 0x44, 0x47, 6}, {'B', 5, 0x24, 0x25},
         {'D', 2}, {'D', 3}},
        {{'B', 1, 0x24, 0x25, 0x80, 0x88, 6}, {'D', 5, 0x2a, 0x2b, 0x44, 0x48, 4}, {'B', 4, 0x24, 0x25},
         {'C', 4}, {'C', 5}}}},
    {"atmega2560", {                     /* Mega: pins 10, 6, 13, 2, 3; 9, 5, 12, 19, 18 */
        {{'B', 4, 0x24, 0x25, 0xb0, 0xb3, 6}, {'H', 3, 0x101, 0x102, 0xa0, 0xa8, 6}, {'B', 7, 0x24, 0x25},
         {'E', 4}, {'E', 5}},
        {{'H', 6, 0x101, 0x102, 0xb0, 0xb4, 4}, {'E', 3, 0x2d, 0x2e, 0x90, 0x98, 6}, {'B', 6, 0x24, 0x25},
         {'D', 2}, {'D', 3}}}},
};

struct queue {
    uint8_t bytes[LINE_BYTES];
    uint64_t at[LINE_BYTES];             /* when a byte has left the UART */
    unsigned first, count;
};

struct board {
    avr_t *avr;
    avr_uart_t *uart;
    avr_ioport_t *ports[2];              /* of the encoders, both pins of each */
    const struct wiring *wiring;
    struct queue to_robot, to_host;
    void (*reset)(struct avr_t *avr);    /* simavr's own */
    uint64_t rx_free;                    /* when the next byte to the robot may begin */
    uint32_t byte_cycles;
    uint8_t phase[2];                    /* of the encoders, in quarters of a period */
    uint32_t overruns, resets;
    uint8_t *eeprom, cells[EEPROM_BYTES]; /* what the cells had before the write that goes on */
    uint8_t worn[EEPROM_BYTES];          /* cells that take no write any more */
    int writing;                         /* address of the cell; -1: none */
    int pins_lost;                       /* by a reset: the encoders have not been set again yet */
};

static void put(struct queue *q, uint8_t byte, uint64_t at) {
    if (q->count < LINE_BYTES) {
        unsigned i = (q->first + q->count++) % LINE_BYTES;
        q->bytes[i] = byte;
        q->at[i] = at;
    }
}

static uint8_t take(struct queue *q) {
    uint8_t byte = q->bytes[q->first];
    q->first = (q->first + 1) % LINE_BYTES;
    q->count--;
    return byte;
}

static void log_nothing(avr_t *avr, const int level, const char *format, va_list ap) {
    (void)avr, (void)level, (void)format, (void)ap;
}

static void sleep_no_real_time(avr_t *avr, avr_cycle_count_t cycles) { (void)avr, (void)cycles; }

static avr_cycle_count_t wake(avr_t *avr, avr_cycle_count_t when, void *param) {
    (void)avr, (void)when, (void)param;
    return 0;
}

static uint64_t now(const struct board *b) { return b->avr->cycle; }

static void on_transmit(struct avr_irq_t *irq, uint32_t value, void *param) {
    struct board *b = param;
    (void)irq;
    put(&b->to_host, (uint8_t)value, now(b) + b->byte_cycles);
}

static avr_cycle_count_t written(avr_t *avr, avr_cycle_count_t when, void *param) {
    struct board *b = param;
    (void)when;
    b->writing = -1;
    avr->data[EECR] &= ~EEPE;
    return 0;
}

/* simavr writes a cell at once; a real one takes its time. */
static void on_eeprom(struct avr_irq_t *irq, uint32_t value, void *param) {
    struct board *b = param;
    (void)irq;
    if (!(value & EEPE) || b->writing >= 0)
        return;
    b->writing = (b->avr->data[EEARL] | b->avr->data[EEARH] << 8) % EEPROM_BYTES;
    if (b->worn[b->writing])
        b->eeprom[b->writing] = b->cells[b->writing];
    b->cells[b->writing] = b->eeprom[b->writing];
    b->avr->data[EECR] |= EEPE;
    avr_cycle_timer_register(b->avr, EEPROM_CYCLES, written, b);
}

static void set_pin(struct board *b, avr_ioport_t *port, const struct pin *pin, int level) {
    avr_irq_t *irq = port->io.irq + pin->bit;
    const uint8_t mask = 1 << pin->bit;
    port->external.pull_mask |= mask;                  /* else simavr lets a pull-up win */
    port->external.pull_value = (port->external.pull_value & ~mask) | level << pin->bit;
    if (b->pins_lost)
        irq->value = !level;                           /* else simavr takes it for the level that there was */
    avr_raise_irq(irq, level);
}

static void set_encoder(struct board *b, int side) {
    const struct wheel *w = &b->wiring->wheels[side];
    const unsigned phase = b->phase[side] & 3;         /* A leads B while the wheel turns forward */
    set_pin(b, b->ports[side], &w->a, phase == 1 || phase == 2);
    set_pin(b, b->ports[side], &w->b, phase >= 2);
}

/* After a reset, and at the beginning. */
static void set_pins(struct board *b) {
    for (uint8_t i = 0; i < EXTINT_COUNT; i++)         /* else simavr looks at a pin that is low in every cycle */
        avr_extint_set_strict_lvl_trig(b->avr, i, 0);
    for (int side = 0; side < 2; side++)
        set_encoder(b, side);
    b->pins_lost = 0;
}

/* simavr calls it at each reset, whatever the cause, before it resets its ports. */
static void on_reset(avr_t *avr) {
    struct board *b = avr->custom.data;
    b->resets++;
    b->writing = -1;
    b->pins_lost = 1;
    if (b->reset)
        b->reset(avr);
}

struct board *board_new(const char *elf, const char *mcu, uint32_t baud) {
    struct board *b = calloc(1, sizeof *b);
    elf_firmware_t firmware = {{0}};
    avr_global_logger_set(log_nothing);
    for (unsigned i = 0; i < sizeof wirings / sizeof *wirings; i++)
        if (!strcmp(wirings[i].mcu, mcu))
            b->wiring = &wirings[i];
    b->avr = b->wiring ? avr_make_mcu_by_name(mcu) : NULL;
    if (!b->avr || elf_read_firmware(elf, &firmware)) {
        free(b);
        return NULL;
    }
    avr_init(b->avr);
    firmware.frequency = 16000000;
    avr_load_firmware(b->avr, &firmware);
    b->avr->sleep = sleep_no_real_time;
    b->avr->custom.data = b;
    b->reset = b->avr->reset;
    b->avr->reset = on_reset;
    b->byte_cycles = 10 * 16000000 / baud;
    for (avr_io_t *io = b->avr->io_port; io; io = io->next)
        for (int side = 0; side < 2; side++)
            if (!strcmp(io->kind, "port") && ((avr_ioport_t *)io)->name == b->wiring->wheels[side].a.port)
                b->ports[side] = (avr_ioport_t *)io;
    for (avr_io_t *io = b->avr->io_port; io; io = io->next)
        if (!strcmp(io->kind, "uart") && ((avr_uart_t *)io)->name == '0')
            b->uart = (avr_uart_t *)io;
    uint32_t no_flags = 0;                             /* neither a copy on the console nor sleep while it polls */
    avr_ioctl(b->avr, AVR_IOCTL_UART_SET_FLAGS('0'), &no_flags);
    avr_irq_register_notify(avr_io_getirq(b->avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_transmit, b);
    avr_irq_register_notify(avr_iomem_getirq(b->avr, EECR, NULL, AVR_IOMEM_IRQ_ALL), on_eeprom, b);
    avr_eeprom_desc_t whole = {.ee = NULL, .offset = 0, .size = 0};
    avr_ioctl(b->avr, AVR_IOCTL_EEPROM_GET, &whole);
    b->eeprom = whole.ee;
    memcpy(b->cells, b->eeprom, EEPROM_BYTES);
    b->writing = -1;
    b->avr->data[MCUSR] |= PORF;
    b->pins_lost = 1;
    return b;
}

void board_free(struct board *b) {
    avr_terminate(b->avr);
    free(b);
}

/* Reset it for the causes, bits of MCUSR. Where its power was too low, `seed` says what then stands in its memory, and
 * in the cell of the EEPROM that was being written. */
void board_reset(struct board *b, uint8_t causes, uint32_t seed) {
    if (causes & (PORF | BORF) && b->writing >= 0)
        b->eeprom[b->writing] = b->cells[b->writing] = seed;
    avr_reset(b->avr);
    b->avr->data[MCUSR] = causes;
    if (causes & (PORF | BORF))
        for (unsigned i = b->avr->ioend + 1; i <= b->avr->ramend; i++) {
            seed = seed * 1664525u + 1013904223u;
            b->avr->data[i] = seed >> 24;
        }
}

static void receive_byte(struct board *b) {
    uint8_t byte = take(&b->to_robot);
    b->rx_free = now(b) + b->byte_cycles;
    if (uart_fifo_get_read_size(&b->uart->input) > UART_DEPTH)
        b->overruns++;                                 /* a real UART loses it; simavr's has room for 64 */
    else
        avr_raise_irq(avr_io_getirq(b->avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT), byte);
}

/* Run for so long, with so many counts of the encoders, evenly spread. Returns simavr's state. */
int board_run(struct board *b, uint64_t cycles, int32_t left, int32_t right) {
    const uint64_t start = now(b), end = start + cycles;
    const int32_t counts[2] = {left, right};
    int32_t made[2] = {0, 0};
    while (now(b) < end && b->avr->state != cpu_Done && b->avr->state != cpu_Crashed) {
        if (b->pins_lost)
            set_pins(b);
        b->uart->cycles_per_byte = b->byte_cycles;     /* simavr takes 11 bits for a byte */
        uint64_t next = end, at[2];
        for (int side = 0; side < 2; side++) {
            int32_t total = abs(counts[side]);
            at[side] = made[side] < total ? start + cycles * (2 * made[side] + 1) / (2 * total) : UINT64_MAX;
            if (at[side] < next)
                next = at[side];
        }
        if (b->to_robot.count && b->rx_free < next)
            next = b->rx_free;
        if (next > now(b)) {                           /* it sleeps no longer than until then, and runs no further */
            avr_cycle_timer_cancel(b->avr, wake, b);
            avr_cycle_timer_register(b->avr, next - now(b), wake, b);
            while (now(b) < next && !b->pins_lost && b->avr->state != cpu_Done && b->avr->state != cpu_Crashed)
                avr_run(b->avr);
        }
        for (int side = 0; side < 2; side++)
            if (at[side] <= now(b)) {
                b->phase[side] += counts[side] > 0 ? 1 : -1;
                made[side]++;
                set_encoder(b, side);
            }
        if (b->to_robot.count && b->rx_free <= now(b))
            receive_byte(b);
    }
    for (int side = 0; side < 2; side++)               /* what it turned while nothing ran */
        if (made[side] < abs(counts[side])) {
            b->phase[side] += counts[side] > 0 ? abs(counts[side]) - made[side] : made[side] - abs(counts[side]);
            b->pins_lost = 1;
        }
    return b->avr->state;
}

void board_receive(struct board *b, const uint8_t *bytes, uint32_t count) {
    for (uint32_t i = 0; i < count; i++)
        put(&b->to_robot, bytes[i], 0);
}

uint32_t board_transmitted(struct board *b, uint8_t *bytes, uint32_t room) {
    uint32_t count = 0;
    while (count < room && b->to_host.count && b->to_host.at[b->to_host.first] <= now(b))
        bytes[count++] = take(&b->to_host);
    return count;
}

/* How long a pin is high, of 255. */
static int level(const struct board *b, const struct pin *pin) {
    const uint8_t *data = b->avr->data;
    if (!(data[pin->ddr] >> pin->bit & 1))
        return 0;                                      /* an input: it is pulled down */
    if (pin->tccr && (data[pin->tccr] >> pin->shift & 3) == SET_ON_MATCH)
        return 255 - data[pin->ocr];
    return data[pin->out] >> pin->bit & 1 ? 255 : 0;
}

/* What the bridge, an L298 or a TB6612, puts on a motor, -255..255. */
int board_voltage(const struct board *b, int side) {
    const struct wheel *w = &b->wiring->wheels[side];
    return level(b, &w->enable) ? level(b, &w->forward) - level(b, &w->backward) : 0;
}

/* Whether it brakes a motor while it does not drive it: an input is high all the time. While both are low, a TB6612 lets
 * it coast. */
int board_brakes(const struct board *b, int side) {
    const struct wheel *w = &b->wiring->wheels[side];
    return level(b, &w->enable) && (level(b, &w->forward) == 255 || level(b, &w->backward) == 255);
}

uint64_t board_cycle(struct board *b) { return now(b); }
uint32_t board_resets(const struct board *b) { return b->resets; }
uint32_t board_overruns(const struct board *b) { return b->overruns; }
uint8_t *board_memory(struct board *b) { return b->avr->data; }

uint8_t *board_flash(struct board *b) { return b->avr->flash; }
uint8_t *board_eeprom(struct board *b) { return b->eeprom; }
uint8_t *board_worn(struct board *b) { return b->worn; }
