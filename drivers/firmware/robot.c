#include "robot.h"

#include "config.h"

#define PI 3.14159265358979323846
#define PER_RAD_S 512.0
#define ONE_COUNT INT32_C(65536)
#define SIXTEENTH (ONE_COUNT / 16) /* of a count */
#define MOST_COUNTS INT32_C(8192)   /* in a tick, and that a wheel can be behind */

/* All of this is computed by the compiler: at run time there are integers only. */
#define TICK_S (ROBOT_TICK_MS * 1e-3)
static const uint32_t counts_per_turn = (uint32_t)(RFP_COUNTS_PER_TURN * 256.0 + 0.5);
static const uint32_t radius_um = (uint32_t)(RFP_WHEEL_RADIUS_M * 1e6 + 0.5);
/* counts in a tick at 1 rad/s [2^-24] */
static const uint32_t counts_per_tick = (uint32_t)(RFP_COUNTS_PER_TURN / (2.0 * PI) * TICK_S * 16777216.0 + 0.5);
/* speed of one count in a window [2^-17 rad/s] */
static const uint32_t speed_per_count = (uint32_t)(2.0 * PI / RFP_COUNTS_PER_TURN / (ROBOT_WINDOW * TICK_S) * PER_RAD_S * 256.0 + 0.5);
static const struct gate_limits limits = {
    .max_wheel = (int16_t)(RFP_MAX_WHEEL_RAD_S * PER_RAD_S + 0.5),
    .max_sum = (uint16_t)(2.0 * RFP_MAX_SPEED_M_S / RFP_WHEEL_RADIUS_M * PER_RAD_S + 0.5),
    .max_ramp = (uint16_t)(RFP_MAX_ACCELERATION_RAD_S2 * 65.536 + 0.5),
};
_Static_assert(RFP_MAX_WHEEL_RAD_S > 0.0 && RFP_MAX_WHEEL_RAD_S <= 63.0, "RFP_MAX_WHEEL_RAD_S: at most 63");
_Static_assert(RFP_MAX_SPEED_M_S > 0.0 && 2.0 * RFP_MAX_SPEED_M_S / RFP_WHEEL_RADIUS_M < 127.0, "RFP_MAX_SPEED_M_S: too fast for its wheels");
_Static_assert(RFP_MAX_ACCELERATION_RAD_S2 >= 1.0 && RFP_MAX_ACCELERATION_RAD_S2 <= 999.0, "RFP_MAX_ACCELERATION_RAD_S2: 1 to 999");
_Static_assert(RFP_COUNTS_PER_TURN >= 20.0 && RFP_COUNTS_PER_TURN <= 200000.0, "RFP_COUNTS_PER_TURN: 20 to 200000");
_Static_assert(sizeof RFP_BUILD <= RFP_BUILD_CHARS + 1u, "RFP_BUILD: at most 16 characters");

/* Bits of `pending`. */
enum { SEND_IDENTITY = 1, SEND_SETTINGS = 2, SEND_LEASE_ANSWER = 4, SEND_STATUS = 8, SEND_HEALTH = 16 };

static int32_t clamp(int32_t value, int32_t limit)
{
    return value > limit ? limit : value < -limit ? -limit : value;
}

static int16_t short_of(int32_t value)
{
    return (int16_t)clamp(value, INT16_MAX);
}

static int32_t magnitude(int32_t value)
{
    return value < 0 ? -value : value;
}

static int32_t fastest(const struct robot *r)
{
    const int32_t left = magnitude(r->wheels[0].speed);
    const int32_t right = magnitude(r->wheels[1].speed);
    return left > right ? left : right;
}

/* Step the gate with what arrived. Where its output is zero, the motors brake in the same call. */
static void step(struct robot *r, struct gate_inputs *i)
{
    i->latch = r->latch;
    i->turning = fastest(r) > ROBOT_TURNING;
    const int8_t granted = gate_step(&r->gate, &limits, i, r->now);
    if (granted != LEASE_NOT_ASKED) {
        r->lease_session = i->lease_session;
        r->lease_granted = granted == LEASE_GRANTED;
        r->pending |= SEND_LEASE_ANSWER;
    }
    if (gate_stands(&r->gate)) {
        board_pwm(BOARD_LEFT, 0);
        board_pwm(BOARD_RIGHT, 0);
        r->wheels[0].error = 0;
        r->wheels[1].error = 0;
    }
    memory_keep(&r->memory, r->gate.latch, r->gate.latch_id);
}

static void take_command(struct robot *r, const uint8_t *body)
{
    struct gate_inputs i = {
        .command = true,
        .command_epoch = rfp_u16(body, 1u),
        .command_session = rfp_u32(body, 3u),
        .command_seq = rfp_u32(body, 7u),
        .command_boot_id = rfp_u32(body, 11u),
        .command_nonce = rfp_u32(body, 15u),
        .command_left = (int16_t)rfp_u16(body, 19u),
        .command_right = (int16_t)rfp_u16(body, 21u),
    };
    step(r, &i);
}

static void take_permission(struct robot *r, const uint8_t *body)
{
    const uint8_t latch = rfp_u8(body, 15u);
    struct gate_inputs i = {
        .permission = true,
        .permission_epoch = rfp_u16(body, 1u),
        .permission_seq = rfp_u32(body, 3u),
        .permission_boot_id = rfp_u32(body, 7u),
        .permission_nonce = rfp_u32(body, 11u),
        .permission_latch = latch <= LATCH_RUNAWAY ? latch : LATCH_EMERGENCY_STOP, /* of another version */
        .permission_clear = rfp_u32(body, 16u),
        .permission_limit = (int16_t)rfp_u16(body, 20u),
    };
    step(r, &i);
}

static void take_lease(struct robot *r, const uint8_t *body)
{
    struct gate_inputs i = {.lease = true, .lease_session = rfp_u32(body, 1u), .lease_action = rfp_u8(body, 5u)};
    step(r, &i);
}

/* Only while the wheels stand: gains that change in mid-drive are a jerk. The answer shows what holds. */
static void take_gains(struct robot *r, const uint8_t *body)
{
    const struct rfp_gains gains = {.kp = rfp_u16(body, 1u), .ki = rfp_u16(body, 3u), .kff = rfp_u16(body, 5u)};
    if (gate_stands(&r->gate) && gains.kp <= ROBOT_MAX_GAIN && gains.ki <= ROBOT_MAX_GAIN && gains.kff <= ROBOT_MAX_GAIN) {
        r->gains = gains;
    }
    r->pending |= SEND_SETTINGS;
}

static void take(struct robot *r, const uint8_t *body, uint8_t length)
{
    const uint8_t type = body[0] >> 4;
    if (type == RFP_COMMAND && length == RFP_COMMAND_BYTES) {
        take_command(r, body);
    } else if (type == RFP_PERMISSION && length == RFP_PERMISSION_BYTES) {
        take_permission(r, body);
    } else if (type == RFP_LEASE && length == RFP_LEASE_BYTES) {
        take_lease(r, body);
    } else if (type == RFP_GAINS && length == RFP_GAINS_BYTES) {
        take_gains(r, body);
    } else if (type == RFP_HELLO && length == RFP_HELLO_BYTES) {
        r->pending |= SEND_IDENTITY | SEND_SETTINGS | SEND_HEALTH;
    } else {
        r->receiver.struck++; /* of another version, or for somebody else */
    }
}

static void listen(struct robot *r)
{
    uint8_t byte;
    for (uint8_t k = 0u; k < RFP_LINE_BYTES && board_uart_read(&byte); k++) {
        const uint8_t length = rfp_receive(&r->receiver, byte);
        if (length > 0u) {
            take(r, r->receiver.bytes, length);
            return; /* one frame a loop */
        }
    }
}

/* Counts at the newest tick, or so many ticks before it. */
static uint16_t counts_ago(const struct robot *r, const struct wheel *w, uint8_t ticks)
{
    return w->window[(r->place + ROBOT_WINDOW - 1u - ticks) % ROBOT_WINDOW];
}

static int32_t output(const struct robot *r, enum board_side side)
{
    return side == BOARD_LEFT ? r->gate.output_left : r->gate.output_right;
}

/* How far the wheel should turn in a tick [2^-16 counts]. */
static int32_t expected(int32_t output_speed)
{
    return (int32_t)((int64_t)output_speed * (int64_t)counts_per_tick >> 24);
}

/* Read an encoder; returns whether the wheel is blocked: it does not turn though it is driven. */
static bool look(struct robot *r, enum board_side side)
{
    struct wheel *w = &r->wheels[side];
    const int32_t counts = board_encoder(side);
    const int32_t turned = (int32_t)((uint32_t)counts - (uint32_t)w->counts);

    w->error = clamp(w->error + expected(output(r, side)) - clamp(turned, MOST_COUNTS) * ONE_COUNT, MOST_COUNTS * ONE_COUNT);
    w->counts = counts;
    const int32_t in_window = (int16_t)((uint16_t)counts - w->window[r->place]);
    w->speed = short_of(clamp(in_window, (int32_t)(INT32_MAX / speed_per_count)) * (int32_t)speed_per_count / 256);
    w->window[r->place] = (uint16_t)counts;
    if (turned != 0 || magnitude(output(r, side)) < RUNAWAY_TURNING * GATE_SPEED_TO_OUTPUT) {
        w->rolled = r->now;
    }
    return r->now - w->rolled >= ROBOT_BLOCKED_MS;
}

static void drive(struct robot *r, enum board_side side, bool due)
{
    struct wheel *w = &r->wheels[side];
    const int32_t speed = output(r, side);
    const int32_t step_counts = expected(speed);
    const int16_t turned = (int16_t)((uint16_t)w->counts - counts_ago(r, w, ROBOT_SHORT));
    const int32_t recent = step_counts / SIXTEENTH * (int32_t)ROBOT_SHORT - (int32_t)turned * 16;
    const int32_t behind = w->error / SIXTEENTH;
    const int32_t wanted = speed / GATE_SPEED_TO_OUTPUT * (int32_t)r->gains.kff / 4096
                           + clamp(recent, INT16_MAX) * (int32_t)r->gains.kp / 256
                           + clamp(behind, INT16_MAX) * (int32_t)r->gains.ki / 256;
    const int32_t duty = clamp(wanted, BOARD_FULL_DUTY);

    if (due && wanted != duty && (wanted > 0) == (w->error > 0)) { /* it gives all it has: it will not catch up with more */
        w->error -= step_counts - (int32_t)(int16_t)((uint16_t)w->counts - counts_ago(r, w, 1u)) * ONE_COUNT;
    }
    board_pwm(side, (int16_t)duty);
}

/* The robot's own reason to stop, while it lasts; the gravest one. */
static void judge(struct robot *r, bool blocked)
{
    bool runs = false;

    for (uint8_t side = 0; side < 2u; side++) {
        struct wheel *w = &r->wheels[side];
        runs = runaway_look(&w->runaway, output(r, side), w->speed, r->now) || runs;
    }
    r->faults = (uint8_t)(board_faults() | (blocked ? FAULT_OVERCURRENT : 0));
    r->felt = (uint8_t)(r->faults | (r->gate.latch != LATCH_NONE ? r->felt : 0));
    if (runs) {
        r->latch = LATCH_RUNAWAY;
    } else if ((r->faults & ~FAULT_WIRED_STOP) != 0) {
        r->latch = LATCH_ROBOT_FAULT;
    } else if (r->memory.broken) {
        r->latch = LATCH_MEMORY_LOST; /* a latch would not be kept */
    } else {
        r->latch = r->faults != 0 ? LATCH_WIRED_STOP : LATCH_NONE;
    }
}

static void tick(struct robot *r, bool due)
{
    struct gate_inputs nothing = {0};

    if (due) {
        const bool left = look(r, BOARD_LEFT);
        const bool right = look(r, BOARD_RIGHT);
        r->place = (uint8_t)((r->place + 1u) % ROBOT_WINDOW);
        r->tick = r->now;
        judge(r, left || right);
    }
    step(r, &nothing);
    if (!gate_stands(&r->gate)) { /* in every millisecond: a command is not to wait for the encoders */
        drive(r, BOARD_LEFT, due);
        drive(r, BOARD_RIGHT, due);
    }
    if (r->now - r->status >= ROBOT_STATUS_MS) {
        r->status = r->now;
        r->pending |= SEND_STATUS;
    }
    if (r->now - r->health >= ROBOT_HEALTH_MS) {
        r->health = r->now;
        r->pending |= SEND_HEALTH;
    }
}

static uint8_t put_status(const struct robot *r, uint8_t *body)
{
    const struct gate *g = &r->gate;
    const struct rfp_status m = {
        .boot_id = g->boot_id,
        .nonce = r->now,
        .count_left = r->wheels[0].counts,
        .count_right = r->wheels[1].counts,
        .speed_left = r->wheels[0].speed,
        .speed_right = r->wheels[1].speed,
        .output_left = (int16_t)(g->output_left / GATE_SPEED_TO_OUTPUT),
        .output_right = (int16_t)(g->output_right / GATE_SPEED_TO_OUTPUT),
        .gate = g->status,
        .latch = g->latch,
        .faults = r->faults,
        .felt = r->felt,
    };
    return rfp_put_status(body, r->count, &m);
}

static uint8_t put_health(const struct robot *r, uint8_t *body)
{
    const struct gate *g = &r->gate;
    const struct rfp_health m = {
        .epoch = g->epoch,
        .session = g->session,
        .latch_id = g->latch_id,
        .refused = (uint16_t)g->refused,
        .struck = r->receiver.struck,
        .lost = r->receiver.lost,
        .battery = board_battery_mv(),
        .current_left = board_current_ma(BOARD_LEFT),
        .current_right = board_current_ma(BOARD_RIGHT),
        .target_after = short_of(g->target_after),
        .output_after = short_of(g->output_after),
        .loop_us = r->loop_us,
        .memory = r->memory.broken ? 1u : 0u,
        .reset = board_reset_cause(),
    };
    return rfp_put_health(body, r->count, &m);
}

static uint8_t put_identity(const struct robot *r, uint8_t *body)
{
    const struct rfp_identity m = {
        .board = board_name, .build = RFP_BUILD, .hash = (uint32_t)(RFP_HASH), .reset = board_reset_cause()};
    return rfp_put_identity(body, r->count, &m);
}

static uint8_t put_settings(const struct robot *r, uint8_t *body)
{
    const struct rfp_settings m = {
        .counts = counts_per_turn,
        .radius = radius_um,
        .max_wheel = limits.max_wheel,
        .max_sum = limits.max_sum,
        .max_ramp = limits.max_ramp,
        .gains = r->gains,
    };
    return rfp_put_settings(body, r->count, &m);
}

/* Send the most urgent frame that is due, if the line has room for it. */
static void send(struct robot *r)
{
    uint8_t body[RFP_BODY_BYTES];
    uint8_t line[RFP_LINE_BYTES];
    uint8_t length;
    uint8_t sent;

    if ((r->pending & SEND_STATUS) != 0u) {
        sent = SEND_STATUS;
        length = put_status(r, body);
    } else if ((r->pending & SEND_LEASE_ANSWER) != 0u) {
        sent = SEND_LEASE_ANSWER;
        length = rfp_put_lease_answer(body, r->count, r->lease_session, r->gate.epoch, r->lease_granted);
    } else if ((r->pending & SEND_IDENTITY) != 0u) {
        sent = SEND_IDENTITY;
        length = put_identity(r, body);
    } else if ((r->pending & SEND_SETTINGS) != 0u) {
        sent = SEND_SETTINGS;
        length = put_settings(r, body);
    } else if ((r->pending & SEND_HEALTH) != 0u) {
        sent = SEND_HEALTH;
        length = put_health(r, body);
    } else {
        return;
    }
    if (board_uart_write(line, rfp_frame(line, body, length))) {
        r->pending &= (uint8_t)~sent;
        r->count++;
    }
}

void robot_start(struct robot *r)
{
    *r = (struct robot){0};
    const struct kept kept = memory_start(&r->memory);
    r->now = GATE_VALID_MS;
    r->us = board_now_us();
    r->tick = r->now;
    r->status = r->now;
    r->health = r->now;
    r->gains = (struct rfp_gains){.kp = RFP_KP, .ki = RFP_KI, .kff = RFP_KFF};
    for (uint8_t side = 0u; side < 2u; side++) {
        struct wheel *w = &r->wheels[side];
        w->counts = board_encoder((enum board_side)side);
        for (uint8_t k = 0u; k < ROBOT_WINDOW; k++) {
            w->window[k] = (uint16_t)w->counts;
        }
    }
    gate_init(&r->gate, kept.boot_id, kept.latch, kept.latch_id, r->now);
}

void robot_loop(struct robot *r)
{
    const uint32_t begin = board_now_us();
    const uint32_t passed = begin - r->us;
    bool due = false; /* the speed loops: the line waits for the next loop then, which keeps the longest one short */

    board_watchdog_kick();
    if (passed >= 1000u) {
        const uint32_t whole_ms = passed / 1000u;
        r->us += whole_ms * 1000u;
        r->now += whole_ms;
        if (r->now < GATE_VALID_MS) {
            r->now += GATE_VALID_MS; /* after 49.7 days; the gate takes it for a clock that was set back */
        }
        due = r->now - r->tick >= ROBOT_TICK_MS;
    }
    if (!due) {
        listen(r);
    }
    if (passed >= 1000u) {
        tick(r, due);
    }
    if (!due) {
        send(r);
    }
    memory_step(&r->memory);
    const uint32_t took = board_now_us() - begin;
    if (took > r->loop_us) {
        r->loop_us = (uint16_t)(took < UINT16_MAX ? took : UINT16_MAX);
    }
}
