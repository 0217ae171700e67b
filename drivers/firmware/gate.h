/* The last gate before a robot's wheels: the state machine of robofleet/safety/gate.py in freestanding C11.
 *
 * Integers only, no heap, no clock, no globals: one struct of state, one step. Units:
 *   instants, nonces  uint32_t [ms], the robot's own clock. It begins at GATE_VALID_MS, so that nonce 0 is too old at
 *                     every instant. After 49.7 days it begins anew: the gate then counts its boot id on, as after any
 *                     clock that was set back, and nothing that was issued before is valid.
 *   speeds            int16_t [2^-9 rad/s], forward +; as on the line
 *   outputs           int32_t [2^-16 rad/s]: the ramp needs the digits
 * tests/safety/test_gate_in_c.py drives both gates with the same inputs.
 */
#ifndef ROBOFLEET_GATE_H
#define ROBOFLEET_GATE_H

#include <stdbool.h>
#include <stdint.h>

#define GATE_VALID_MS 120u      /* a command and a permission are valid until their nonce is so old */
#define GATE_LAPSE_MS 1000u     /* a lease whose holder gave no command for so long is free, at rest */
#define GATE_RAMP_MS 5u         /* the longest step from rest on a target */
#define GATE_LONGEST_RAMP_MS 20u /* what a loop that was held up may catch up with in one step */
#define GATE_UNKNOWN (-1)       /* as the figure of a stop: there was none yet */
#define GATE_NEVER 0u           /* as a nonce: none */
#define GATE_SPEED_TO_OUTPUT INT32_C(128) /* 2^-9 rad/s in 2^-16 rad/s */

#define RUNAWAY_TURNING 256     /* 0.5 rad/s */
#define RUNAWAY_FASTER 11       /* eighths of what is commanded */
#define RUNAWAY_RESTS_WITHIN_MS 800u
#define RUNAWAY_LOOKED_WITHIN_MS 100u

enum gate_status { GATE_OPEN, GATE_NO_COMMAND, GATE_NO_ENABLE, GATE_LATCHED, GATE_NO_LEASE };

enum gate_latch {
    LATCH_NONE,
    LATCH_DRILL, /* not kept over a restart */
    LATCH_EMERGENCY_STOP,
    LATCH_WIRED_STOP,
    LATCH_DRIVER_FAILED,
    LATCH_MEMORY_LOST,
    LATCH_ROBOT_FAULT,
    LATCH_RUNAWAY
};

enum lease_action { LEASE_ACQUIRE = 1, LEASE_TAKE_OVER = 2, LEASE_RELEASE = 3 };

enum lease_answer { LEASE_NOT_ASKED = -1, LEASE_REFUSED = 0, LEASE_GRANTED = 1 };

/* What the robot can do. A host cannot change it: it is built in. */
struct gate_limits {
    int16_t max_wheel;  /* fastest wheel [2^-9 rad/s] */
    uint16_t max_sum;   /* of both wheels, by the body's top speed: 2 v / wheel radius [2^-9 rad/s] */
    uint16_t max_ramp;  /* acceleration of a wheel [2^-16 rad/s per ms] */
};

/* What came since the last step; a flag says whether there is a command, a permission, a lease request. */
struct gate_inputs {
    bool command;
    uint16_t command_epoch;
    uint32_t command_session;
    uint32_t command_seq;
    uint32_t command_boot_id;
    uint32_t command_nonce;
    int16_t command_left;
    int16_t command_right;
    bool permission;
    uint16_t permission_epoch;
    uint32_t permission_seq;
    uint32_t permission_boot_id;
    uint32_t permission_nonce;
    uint8_t permission_latch; /* enum gate_latch */
    uint32_t permission_clear; /* latch id */
    int16_t permission_limit; /* fastest wheel; 0: none */
    bool lease;
    uint32_t lease_session;
    uint8_t lease_action;
    uint8_t latch;  /* the robot's own reason to stop, while it lasts */
    bool turning;   /* a wheel turns, as measured */
};

/* What the gate remembers, and what it decided last. Begin with gate_init. */
struct gate {
    uint32_t boot_id;
    uint16_t epoch;   /* of the lease */
    uint8_t latch;    /* kept over a restart, but for a drill */
    uint32_t latch_id; /* kept over a restart */
    uint32_t session; /* of the host that holds the lease; 0: nobody */
    uint32_t heard;   /* when the holder was granted the lease, or gave a command */
    uint32_t seq;     /* of the command accepted last, in this epoch */
    uint32_t command_nonce;
    int16_t left;
    int16_t right;
    uint32_t enabled_nonce;
    uint32_t enabled_seq;
    int16_t limit;
    int16_t target_left;
    int16_t target_right;
    int32_t output_left;
    int32_t output_right;
    uint32_t at;       /* of the last step */
    uint32_t since;    /* what was issued before counts no more: the gate was held up */
    uint32_t moved_by; /* older one of the two nonces by which the target was last not zero */
    int32_t target_after; /* last stop: that nonce's issue to zero target [ms] */
    int32_t output_after; /* and to zero output [ms] */
    uint32_t refused;
    uint8_t status;    /* enum gate_status */
};

/* A wheel that turns by itself (robofleet/safety/runaway.py). */
struct runaway {
    uint32_t since;
    uint32_t looked;
    int8_t direction; /* 1, -1; 0: it obeys */
};

/* Let a gate begin at `now` >= GATE_VALID_MS with what was kept: nobody has the lease, the wheels stand. */
void gate_init(struct gate *g, uint32_t boot_id, uint8_t latch, uint32_t latch_id, uint32_t now);

/* Take what arrived, and decide what the wheels are given now. Returns enum lease_answer. */
int8_t gate_step(struct gate *g, const struct gate_limits *limits, const struct gate_inputs *i, uint32_t now);

/* Whether the wheels are given zero. */
bool gate_stands(const struct gate *g);

/* Look at a wheel's output [2^-16 rad/s] and its measured speed [2^-9 rad/s]; returns whether it turns by itself. */
bool runaway_look(struct runaway *r, int32_t output, int16_t measured, uint32_t now);

#endif
