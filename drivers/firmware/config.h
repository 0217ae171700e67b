/* What is built into a robot's firmware: its geometry, its limits, its line. Give your own by -D, or in this file.
 *
 * A host can read these values, and cannot change them. Its driver refuses a build that does not fit its configuration.
 */
#ifndef ROBOFLEET_CONFIG_H
#define ROBOFLEET_CONFIG_H

#ifndef RFP_COUNTS_PER_TURN
#define RFP_COUNTS_PER_TURN 2248.0 /* encoder counts in one turn of a wheel, gear included; every edge counts */
#endif
#ifndef RFP_WHEEL_RADIUS_M
#define RFP_WHEEL_RADIUS_M 0.0325
#endif
#ifndef RFP_MAX_WHEEL_RAD_S
#define RFP_MAX_WHEEL_RAD_S 12.0 /* at most 63 */
#endif
#ifndef RFP_MAX_SPEED_M_S
#define RFP_MAX_SPEED_M_S 0.3
#endif
#ifndef RFP_MAX_ACCELERATION_RAD_S2
#define RFP_MAX_ACCELERATION_RAD_S2 100.0 /* at most 999 */
#endif
#ifndef RFP_BAUD
#define RFP_BAUD 57600L
#endif
/* Gains until a host gives others; units in robot.h. */
#ifndef RFP_KP
#define RFP_KP 96
#endif
#ifndef RFP_KI
#define RFP_KI 160
#endif
#ifndef RFP_KFF
#define RFP_KFF 683
#endif
#ifndef RFP_BUILD
#define RFP_BUILD "by hand" /* at most 16 characters */
#endif
#ifndef RFP_HASH
#define RFP_HASH 0 /* of the sources: the Makefile gives it */
#endif

_Static_assert(RFP_COUNTS_PER_TURN >= 20 && RFP_COUNTS_PER_TURN <= 200000, "RFP_COUNTS_PER_TURN: 20 to 200000");
_Static_assert(RFP_WHEEL_RADIUS_M >= 0.001 && RFP_WHEEL_RADIUS_M <= 1, "RFP_WHEEL_RADIUS_M: 0.001 to 1, in metres");
_Static_assert(RFP_BAUD >= 57600, "RFP_BAUD: at least 57600");
#ifdef RFP_UART_HZ /* the Makefile gives it: the board's UART divides it by a whole number */
#define RFP_DIVISOR ((RFP_UART_HZ + RFP_BAUD / 2) / RFP_BAUD)
_Static_assert(RFP_DIVISOR > 0 && 40 * (RFP_UART_HZ - RFP_DIVISOR * RFP_BAUD) <= RFP_UART_HZ
                   && 40 * (RFP_DIVISOR * RFP_BAUD - RFP_UART_HZ) <= RFP_UART_HZ,
    "RFP_BAUD: this board cannot make it within 2.5 %; it can make 57600, 115200, 250000 and 500000");
#endif

#endif
