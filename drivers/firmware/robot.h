/* A robot's firmware without its board: bytes to frames, frames to the gate, the gate's output to the wheels.
 *
 * Every loop takes what arrived. Every millisecond the gate is stepped, and the speed loop of each wheel sets its motor.
 * Every 5 ms the encoders are read:
 *
 *     duty = kff speed / 2^12 + (kp error_of_20_ms + ki error) / 2^8
 *
 * speed [2^-9 rad/s] is the gate's output; error [2^-4 counts] is how far the wheel is behind where the gate's outputs
 * would have brought it, and error_of_20_ms what of that came in the last 20 ms. BOARD_FULL_DUTY is the whole voltage.
 * While both outputs are zero both motors brake, whatever the errors are.
 */
#ifndef ROBOFLEET_ROBOT_H
#define ROBOFLEET_ROBOT_H

#include "board.h"
#include "gate.h"
#include "memory.h"
#include "rfp.h"

#define ROBOT_TICK_MS 5u
#define ROBOT_WINDOW 10u    /* ticks: over so many a speed is measured */
#define ROBOT_SHORT 4u      /* ticks of the proportional part */
#define ROBOT_MAX_GAIN 8191u
#define ROBOT_TURNING 26    /* 0.05 rad/s: a wheel that is measured faster is not at rest */
#define ROBOT_STATUS_MS 10u
#define ROBOT_HEALTH_MS 100u
#define ROBOT_BLOCKED_MS 500u /* a wheel that is driven and does not turn for so long is blocked */

struct wheel {
    int32_t counts;               /* at the last tick */
    uint16_t window[ROBOT_WINDOW]; /* counts at the last ticks */
    int32_t error;                /* [2^-16 counts] */
    int16_t speed;                /* measured over the window [2^-9 rad/s] */
    struct runaway runaway;
    uint32_t rolled;              /* when it turned last, or was not driven */
};

struct robot {
    struct gate gate;
    struct memory memory;
    struct rfp_receiver receiver;
    struct wheel wheels[2];
    struct rfp_gains gains;
    uint32_t us;      /* of the board's clock: until then `now` counts */
    uint32_t now;     /* the gate's clock [ms] */
    uint32_t tick;    /* instants of the last ones */
    uint32_t status;
    uint32_t health;
    uint32_t lease_session; /* of the newest answer */
    uint16_t loop_us;
    uint8_t place;    /* in the windows: of the oldest counts */
    uint8_t latch;    /* the robot's own reason to stop */
    uint8_t faults;   /* enum board_fault: those that last */
    uint8_t felt;     /* and those since the gate was latched */
    uint8_t pending;  /* what is to be sent */
    uint8_t count;    /* of frames sent */
    bool lease_granted;
};

/* Switch on: the board is ready. */
void robot_start(struct robot *r);

/* Do what is due; called as often as the board can. */
void robot_loop(struct robot *r);

#endif
