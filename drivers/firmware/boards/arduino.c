/* Arduino Uno and Mega with an L298 or TB6612 and two quadrature encoders, wired as for ros_arduino_bridge (README.md).
 *
 * Timers make the motors' PWM (490 Hz, phase correct, as Arduino's own on pins 9 and 10) and the clock. Every edge of an
 * encoder is an interrupt. The microcontroller sleeps between interrupts.
 */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <util/atomic.h>

#include "../config.h"
#include "../robot.h"

enum { BUFFER = 128, BUFFER_MASK = BUFFER - 1 };        /* bytes of the line, each way */
enum { BAUD_DIVISOR = (F_CPU / 4 / RFP_BAUD - 1) / 2 }; /* at double speed, rounded */
enum { TICKS = 250, TICK_US = 4 };                      /* of the clock's timer in a millisecond: 16 MHz / 64 */

/* Arduino's numbers of the pins stand at the right. A motor's pin is low for so much of 255 as its register says. */
#if defined(__AVR_ATmega328P__)
const char board_name[] = "uno";
enum { LEFT_ENABLE = _BV(5), RIGHT_ENABLE = _BV(4) };                        /* 13, 12 */
#define LEFT_FORWARD OCR1B                                                   /* 10 */
#define LEFT_BACKWARD OCR0A                                                  /* 6 */
#define RIGHT_FORWARD OCR1A                                                  /* 9 */
#define RIGHT_BACKWARD OCR0B                                                 /* 5 */
#define LEFT_AB (PIND >> 2 & 3)                                              /* 2, 3 */
#define RIGHT_AB (PINC >> 4 & 3)                                             /* A4, A5 */
#define LEFT_ISR ISR(PCINT2_vect)
#define RIGHT_ISR ISR(PCINT1_vect)
#define RECEIVED_VECTOR USART_RX_vect
#define SENT_VECTOR USART_UDRE_vect
#define CLOCK_ISR ISR(TIMER2_COMPA_vect)
#define CLOCK_COUNTER TCNT2
#define CLOCK_DUE (TIFR2 & _BV(OCF2A))

static void start_pins_and_timers(void)
{
    PORTB = 0;
    DDRB = _BV(1) | _BV(2) | LEFT_ENABLE | RIGHT_ENABLE;
    DDRD = _BV(5) | _BV(6);
    PORTD = _BV(2) | _BV(3); /* the encoders' pull-ups */
    PORTC = _BV(4) | _BV(5);
    TCCR0A = _BV(WGM00) | _BV(COM0A1) | _BV(COM0A0) | _BV(COM0B1) | _BV(COM0B0);
    TCCR0B = _BV(CS01) | _BV(CS00);
    TCCR1A = _BV(WGM10) | _BV(COM1A1) | _BV(COM1A0) | _BV(COM1B1) | _BV(COM1B0);
    TCCR1B = _BV(CS11) | _BV(CS10);
    OCR2A = TICKS - 1;
    TCCR2A = _BV(WGM21);
    TCCR2B = _BV(CS22);
    TIMSK2 = _BV(OCIE2A);
    PCMSK2 = _BV(PCINT18) | _BV(PCINT19);
    PCMSK1 = _BV(PCINT12) | _BV(PCINT13);
    PCICR = _BV(PCIE2) | _BV(PCIE1);
}
#elif defined(__AVR_ATmega2560__)
const char board_name[] = "mega";
enum { LEFT_ENABLE = _BV(7), RIGHT_ENABLE = _BV(6) };                        /* 13, 12 */
#define LEFT_FORWARD OCR2A                                                   /* 10 */
#define LEFT_BACKWARD OCR4A                                                  /* 6 */
#define RIGHT_FORWARD OCR2B                                                  /* 9 */
#define RIGHT_BACKWARD OCR3A                                                 /* 5 */
#define LEFT_AB (PINE >> 4 & 3)                                              /* 2, 3 */
#define RIGHT_AB (PIND >> 2 & 3)                                             /* 19, 18 */
#define LEFT_ISR ISR(INT5_vect, ISR_ALIASOF(INT4_vect)); ISR(INT4_vect)
#define RIGHT_ISR ISR(INT3_vect, ISR_ALIASOF(INT2_vect)); ISR(INT2_vect)
#define RECEIVED_VECTOR USART0_RX_vect
#define SENT_VECTOR USART0_UDRE_vect
#define CLOCK_ISR ISR(TIMER0_COMPA_vect)
#define CLOCK_COUNTER TCNT0
#define CLOCK_DUE (TIFR0 & _BV(OCF0A))

static void start_pins_and_timers(void)
{
    PORTB = 0;
    DDRB = _BV(4) | LEFT_ENABLE | RIGHT_ENABLE;
    DDRH = _BV(3) | _BV(6);
    DDRE = _BV(3);
    PORTE = _BV(4) | _BV(5); /* the encoders' pull-ups */
    PORTD = _BV(2) | _BV(3);
    TCCR2A = _BV(WGM20) | _BV(COM2A1) | _BV(COM2A0) | _BV(COM2B1) | _BV(COM2B0);
    TCCR2B = _BV(CS22);
    TCCR3A = TCCR4A = _BV(WGM30) | _BV(COM3A1) | _BV(COM3A0);
    TCCR3B = TCCR4B = _BV(CS31) | _BV(CS30);
    OCR0A = TICKS - 1;
    TCCR0A = _BV(WGM01);
    TCCR0B = _BV(CS01) | _BV(CS00);
    TIMSK0 = _BV(OCIE0A);
    EICRB = _BV(ISC40) | _BV(ISC50); /* either edge */
    EICRA = _BV(ISC20) | _BV(ISC30);
    EIMSK = _BV(INT4) | _BV(INT5) | _BV(INT2) | _BV(INT3);
}
#else
#error "boards/arduino.c knows the ATmega328P (Uno) and the ATmega2560 (Mega)"
#endif

/* --- Reset. --- */

/* The boot loader of an Uno clears MCUSR before this program begins. So the watchdog says by itself that it was it. */
enum { BITTEN = 0xb17e };
static uint16_t bitten __attribute__((section(".noinit")));
static uint8_t reset_flags __attribute__((section(".noinit")));

/* Before main: the watchdog goes on after the reset that it made, with its shortest time. */
__attribute__((naked, used, section(".init3"))) static void read_reset_flags(void)
{
    reset_flags = MCUSR;
    if (reset_flags == 0 && bitten == BITTEN)
        reset_flags = RESET_WATCHDOG;
    bitten = 0;
    MCUSR = 0;
    wdt_disable();
}

uint8_t board_reset_cause(void)
{
    return reset_flags; /* the bits of MCUSR are those of enum board_reset */
}

static void start_watchdog(void)
{
    wdt_enable(WDTO_120MS);
    WDTCSR |= _BV(WDIE); /* the first time it calls, the second time it resets */
}

void board_watchdog_kick(void)
{
    wdt_reset();
}

ISR(WDT_vect)
{
    board_pwm(BOARD_LEFT, 0);
    board_pwm(BOARD_RIGHT, 0);
    bitten = BITTEN;
    wdt_enable(WDTO_15MS);
    wdt_reset();
    for (;;) { /* until it resets */
    }
}

/* --- Clock. --- */

static volatile uint32_t milliseconds;

CLOCK_ISR
{
    milliseconds++;
}

uint32_t board_now_us(void)
{
    uint32_t ms;
    uint8_t ticks;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        ms = milliseconds;
        ticks = CLOCK_COUNTER;
        if (CLOCK_DUE && ticks < TICKS / 2) { /* it began anew, and its interrupt waits */
            ms++;
        }
    }
    return ms * 1000u + (uint16_t)(ticks * TICK_US);
}

/* --- Encoders: each edge counts. At 20,000 counts a second of both wheels this takes a sixth of the time. --- */

static volatile uint16_t counts[2]; /* short, for the interrupts' sake */

#define COUNT(side, ab, seen) /* seen: A and B before, in a register that is read in one cycle */ \
    do { \
        static const int8_t steps[16] = {0, 1, -1, 0, -1, 0, 0, 1, 1, 0, 0, -1, 0, -1, 1, 0}; \
        const uint8_t edge = (uint8_t)((seen) << 2 & 12) | (ab); \
        (seen) = edge; \
        counts[side] += (uint16_t)steps[edge]; \
    } while (0)

LEFT_ISR
{
    COUNT(BOARD_LEFT, LEFT_AB, GPIOR1);
}

RIGHT_ISR
{
    COUNT(BOARD_RIGHT, RIGHT_AB, GPIOR2);
}

int32_t board_encoder(enum board_side side)
{
    static int32_t total[2];
    uint16_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        now = counts[side];
    }
    total[side] += (int16_t)(now - (uint16_t)total[side]);
    return total[side];
}

/* --- Line: the UART of the USB port. --- */

struct buffer {
    uint8_t bytes[BUFFER];
    volatile uint8_t in;
    volatile uint8_t out;
};

static struct buffer received;
static struct buffer sending;

ISR(RECEIVED_VECTOR)
{
    const uint8_t byte = UDR0;
    const uint8_t next = (received.in + 1u) & BUFFER_MASK;
    if (next != received.out) {
        received.bytes[received.in] = byte;
        received.in = next;
    }
}

ISR(SENT_VECTOR)
{
    if (sending.out == sending.in) {
        UCSR0B &= (uint8_t)~_BV(UDRIE0);
        return;
    }
    UDR0 = sending.bytes[sending.out];
    sending.out = (sending.out + 1u) & BUFFER_MASK;
}

bool board_uart_read(uint8_t *byte)
{
    if (received.out == received.in) {
        return false;
    }
    *byte = received.bytes[received.out];
    received.out = (received.out + 1u) & BUFFER_MASK;
    return true;
}

bool board_uart_write(const uint8_t *bytes, uint8_t length)
{
    uint8_t in = sending.in;
    if (((sending.out - in - 1u) & BUFFER_MASK) < length) {
        return false;
    }
    for (uint8_t k = 0u; k < length; k++) {
        sending.bytes[in] = bytes[k];
        in = (in + 1u) & BUFFER_MASK;
    }
    sending.in = in;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        UCSR0B |= _BV(UDRIE0);
    }
    return true;
}

/* --- Motors: one input is high, the other one low for as long as the motor drives. Else both are high: it brakes. --- */

void board_pwm(enum board_side side, int16_t duty)
{
    const uint16_t size = (uint16_t)(duty < 0 ? -duty : duty);
    const uint8_t level = (uint8_t)((size - (size >> 8)) >> 2); /* of 255 */
    const uint8_t forward = duty < 0 ? level : 0; /* how long this input is low */
    const uint8_t backward = duty < 0 ? 0 : level;
    if (side == BOARD_LEFT) {
        LEFT_FORWARD = forward;
        LEFT_BACKWARD = backward;
    } else {
        RIGHT_FORWARD = forward;
        RIGHT_BACKWARD = backward;
    }
}

/* --- EEPROM. --- */

bool board_eeprom_ready(void)
{
    return (EECR & _BV(EEPE)) == 0;
}

uint8_t board_eeprom_read(uint8_t address)
{
    EEAR = address;
    EECR |= _BV(EERE);
    return EEDR;
}

void board_eeprom_write(uint8_t address, uint8_t value)
{
    EEAR = address;
    EEDR = value;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        EECR |= _BV(EEMPE);
        EECR |= _BV(EEPE);
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

int main(void)
{
    static struct robot robot;

    start_pins_and_timers();
    GPIOR1 = LEFT_AB;
    GPIOR2 = RIGHT_AB;
    UCSR0A = _BV(U2X0);
    UBRR0 = BAUD_DIVISOR;
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
    start_watchdog();
    sei();
    robot_start(&robot);
    PORTB |= LEFT_ENABLE | RIGHT_ENABLE;
    for (;;) {
        robot_loop(&robot);
        cli();
        if (received.out == received.in) {
            sleep_enable();
            sei(); /* it acts after the next instruction: no byte is slept over */
            sleep_cpu();
            sleep_disable();
        }
        sei();
    }
}
