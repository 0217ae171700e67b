/* Arduino Uno and Mega with an L298 and two quadrature encoders, wired as for ros_arduino_bridge (README.md).
 *
 * Two timers make the motors' PWM (3.9 kHz, phase correct), a third one the clock. Every edge of an encoder is an
 * interrupt. The microcontroller sleeps between interrupts.
 */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <util/atomic.h>

#include "../board.h"

enum { BUFFER = 128, BUFFER_MASK = BUFFER - 1 }; /* bytes of the line, each way: 22 ms at 57,600 baud */
enum { BAUD_DIVISOR = 34 };                      /* 16 MHz / 8 / (34 + 1) = 57,143 baud */
enum { TICKS = 250, TICK_US = 4 };               /* of the clock's timer in a millisecond: 16 MHz / 64 */

/* Arduino's numbers of the pins stand at the right. */
#if defined(__AVR_ATmega328P__)
enum { LEFT_ENABLE = _BV(5), RIGHT_ENABLE = _BV(4) };                        /* 13, 12 */
#define LEFT_FORWARD(level) PWM(TCCR1A, COM1B1, OCR1B, level)                /* 10 */
#define LEFT_BACKWARD(level) PWM(TCCR0A, COM0A1, OCR0A, level)               /* 6 */
#define RIGHT_FORWARD(level) PWM(TCCR1A, COM1A1, OCR1A, level)               /* 9 */
#define RIGHT_BACKWARD(level) PWM(TCCR0A, COM0B1, OCR0B, level)              /* 5 */
#define LEFT_AB (PIND >> 2 & 3)                                              /* 2, 3 */
#define RIGHT_AB (PINC >> 4 & 3)                                             /* A4, A5 */
#define LEFT_ISR ISR(PCINT2_vect)
#define RIGHT_ISR ISR(PCINT1_vect)
#define CLOCK_ISR ISR(TIMER2_COMPA_vect)
#define CLOCK_COUNTER TCNT2
#define CLOCK_DUE (TIFR2 & _BV(OCF2A))

static void start_pins_and_timers(void) {
    PORTB = 0;
    DDRB = _BV(1) | _BV(2) | LEFT_ENABLE | RIGHT_ENABLE;
    DDRD = _BV(5) | _BV(6);
    PORTD = _BV(2) | _BV(3); /* the encoders' pull-ups */
    PORTC = _BV(4) | _BV(5);
    TCCR0A = _BV(WGM00);
    TCCR0B = _BV(CS01);
    TCCR1A = _BV(WGM10);
    TCCR1B = _BV(CS11);
    OCR2A = TICKS - 1;
    TCCR2A = _BV(WGM21);
    TCCR2B = _BV(CS22);
    TIMSK2 = _BV(OCIE2A);
    PCMSK2 = _BV(PCINT18) | _BV(PCINT19);
    PCMSK1 = _BV(PCINT12) | _BV(PCINT13);
    PCICR = _BV(PCIE2) | _BV(PCIE1);
}
#elif defined(__AVR_ATmega2560__)
enum { LEFT_ENABLE = _BV(7), RIGHT_ENABLE = _BV(6) };                        /* 13, 12 */
#define LEFT_FORWARD(level) PWM(TCCR2A, COM2A1, OCR2A, level)                /* 10 */
#define LEFT_BACKWARD(level) PWM(TCCR4A, COM4A1, OCR4A, level)               /* 6 */
#define RIGHT_FORWARD(level) PWM(TCCR2A, COM2B1, OCR2B, level)               /* 9 */
#define RIGHT_BACKWARD(level) PWM(TCCR3A, COM3A1, OCR3A, level)              /* 5 */
#define LEFT_AB (PINE >> 4 & 3)                                              /* 2, 3 */
#define RIGHT_AB (PIND >> 2 & 3)                                             /* 19, 18 */
#define LEFT_ISR ISR(INT5_vect, ISR_ALIASOF(INT4_vect)); ISR(INT4_vect)
#define RIGHT_ISR ISR(INT3_vect, ISR_ALIASOF(INT2_vect)); ISR(INT2_vect)
#define CLOCK_ISR ISR(TIMER0_COMPA_vect)
#define CLOCK_COUNTER TCNT0
#define CLOCK_DUE (TIFR0 & _BV(OCF0A))

static void start_pins_and_timers(void) {
    PORTB = 0;
    DDRB = _BV(4) | LEFT_ENABLE | RIGHT_ENABLE;
    DDRH = _BV(3) | _BV(6);
    DDRE = _BV(3);
    PORTE = _BV(4) | _BV(5); /* the encoders' pull-ups */
    PORTD = _BV(2) | _BV(3);
    TCCR2A = _BV(WGM20);
    TCCR2B = _BV(CS21);
    TCCR3A = TCCR4A = _BV(WGM30);
    TCCR3B = TCCR4B = _BV(CS31);
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

#define PWM(mode, bit, compare, level) \
    do { \
        if (level) { \
            (compare) = (level); \
            (mode) |= _BV(bit); \
        } else { \
            (mode) &= (uint8_t)~_BV(bit); /* the pin is low then */ \
        } \
    } while (0)

/* --- reset --- */

static uint8_t reset_flags __attribute__((section(".noinit")));

/* Before main: after a reset by the watchdog it runs on with its shortest time. */
__attribute__((naked, used, section(".init3"))) static void read_reset_flags(void) {
    reset_flags = MCUSR;
    MCUSR = 0;
    wdt_disable();
}
