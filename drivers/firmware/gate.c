#include "gate.h"

static int32_t magnitude(int32_t value)
{
    return value < 0 ? -value : value;
}

static int32_t larger(int32_t a, int32_t b)
{
    return a > b ? a : b;
}

/* 1 % more than the limit is within it. More is refused, never clamped. */
static bool exceeds(int32_t value, int32_t limit)
{
    return value * 100 > limit * 101;
}

bool gate_stands(const struct gate *g)
{
    return g->output_left == 0 && g->output_right == 0;
}

static bool target_stands(const struct gate *g)
{
    return g->target_left == 0 && g->target_right == 0;
}

/* Return way * reach / furthest. The wheel that has furthest to go needs no division, which an AVR has to compute. */
static int32_t part(int32_t way, uint32_t reach, uint32_t furthest)
{
    if ((uint32_t)magnitude(way) == furthest) {
        return way < 0 ? -(int32_t)reach : (int32_t)reach;
    }
    return (int32_t)((int64_t)way * (int64_t)reach / (int64_t)furthest);
}

/* Move the output towards the target by at most `reach`, along the straight line, and time a stop. */
static void follow(struct gate *g, int16_t target_left, int16_t target_right, uint32_t reach, uint32_t now)
{
    const int32_t end_left = (int32_t)target_left * GATE_SPEED_TO_OUTPUT;
    const int32_t end_right = (int32_t)target_right * GATE_SPEED_TO_OUTPUT;
    const int32_t left = end_left - g->output_left;
    const int32_t right = end_right - g->output_right;
    const uint32_t furthest = (uint32_t)larger(magnitude(left), magnitude(right));
    const bool stood = target_stands(g);
    const bool rested = stood && gate_stands(g);

    if (furthest > reach) {
        g->output_left += part(left, reach, furthest);
        g->output_right += part(right, reach, furthest);
    } else {
        g->output_left = end_left;
        g->output_right = end_right;
    }
    g->target_left = target_left;
    g->target_right = target_right;
    g->at = now;
    if (!target_stands(g)) {
        g->moved_by = g->command_nonce < g->enabled_nonce ? g->command_nonce : g->enabled_nonce;
        return;
    }
    const int32_t after = g->moved_by == GATE_NEVER ? GATE_UNKNOWN : (int32_t)(now - g->moved_by);
    if (!stood) {
        g->target_after = after;
        g->output_after = GATE_UNKNOWN;
    }
    if (gate_stands(g) && !rested) {
        g->output_after = after;
    }
}

/* How far the ramp goes until now. On its way it catches up with time that was lost; on its target it had none. */
static uint32_t reached(const struct gate *g, const struct gate_limits *limits, uint32_t now)
{
    const bool on_target = g->output_left == (int32_t)g->target_left * GATE_SPEED_TO_OUTPUT
                           && g->output_right == (int32_t)g->target_right * GATE_SPEED_TO_OUTPUT;
    const uint32_t longest = on_target ? GATE_RAMP_MS : GATE_LONGEST_RAMP_MS;
    const uint32_t passed = now > g->at ? now - g->at : 0u;

    return limits->max_ramp * (passed < longest ? passed : longest);
}

/* The clock was set back: no nonce that was given out before says anything any more. */
static void start_anew(struct gate *g, uint32_t now)
{
    g->boot_id++;
    g->heard = now;
    g->command_nonce = GATE_NEVER;
    g->enabled_nonce = GATE_NEVER;
    g->moved_by = GATE_NEVER;
    g->since = GATE_NEVER;
    g->enabled_seq = 0u;
}

static void close_by(struct gate *g, uint8_t latch)
{
    if (latch > g->latch) {
        g->latch = latch;
        g->latch_id++;
    }
}

static bool valid(uint32_t nonce, uint32_t now)
{
    return now - nonce < GATE_VALID_MS; /* nonce <= now */
}

static bool fresh(const struct gate *g, uint32_t boot_id, uint32_t nonce, uint32_t now)
{
    return boot_id == g->boot_id && g->since <= nonce && nonce <= now && valid(nonce, now);
}

static void take_permission(struct gate *g, const struct gate_inputs *i, bool clearable, uint32_t now)
{
    const bool newer = i->permission_nonce > g->enabled_nonce
                       || (i->permission_nonce == g->enabled_nonce && i->permission_seq > g->enabled_seq);
    const bool concerned = i->permission_epoch == g->epoch || i->permission_latch != LATCH_NONE; /* an e-stop needs no lease */

    if (!(fresh(g, i->permission_boot_id, i->permission_nonce, now) && concerned && newer)) {
        g->refused++;
        return;
    }
    g->enabled_nonce = i->permission_nonce;
    g->enabled_seq = i->permission_seq;
    g->limit = i->permission_limit;
    if (i->permission_latch != LATCH_NONE) {
        close_by(g, i->permission_latch);
        g->limit = 0;
    } else if (g->latch != LATCH_NONE && clearable && i->permission_clear != 0u && i->permission_clear == g->latch_id) {
        g->latch = LATCH_NONE;
        g->limit = 0; /* a reset moves nothing: that takes another permission */
    }
}

static bool take_lease(struct gate *g, uint32_t session, uint8_t action, bool at_rest, uint32_t now)
{
    if (session == 0u) {
        return false;
    }
    if (action == LEASE_RELEASE) {
        if (session != g->session) {
            return false;
        }
        g->session = 0u;
        return true;
    }
    if (session == g->session) {
        return true;
    }
    const bool lapsed = now - g->heard >= GATE_LAPSE_MS;
    if (!(at_rest && (g->session == 0u || lapsed || action == LEASE_TAKE_OVER))) {
        return false;
    }
    g->epoch++;
    g->session = session;
    g->heard = now;
    g->seq = 0u;
    g->command_nonce = GATE_NEVER;
    g->limit = 0;
    return true;
}

/* Whether the robot can do that. */
static bool within(const struct gate_limits *limits, int32_t left, int32_t right)
{
    return !exceeds(magnitude(left + right), limits->max_sum) && !exceeds(magnitude(left), limits->max_wheel)
           && !exceeds(magnitude(right), limits->max_wheel);
}

static void take_command(struct gate *g, const struct gate_limits *limits, const struct gate_inputs *i, uint32_t now)
{
    if (!(fresh(g, i->command_boot_id, i->command_nonce, now) && i->command_epoch == g->epoch
          && i->command_session == g->session && g->session != 0u && i->command_seq > g->seq
          && within(limits, i->command_left, i->command_right))) {
        g->refused++;
        return;
    }
    g->seq = i->command_seq;
    g->command_nonce = i->command_nonce;
    g->heard = now;
    g->left = i->command_left;
    g->right = i->command_right;
}

/* Why the wheels may turn now, or why they may not. */
static enum gate_status judged(const struct gate *g, uint32_t now)
{
    if (g->latch != LATCH_NONE) {
        return GATE_LATCHED;
    }
    if (g->session == 0u) {
        return GATE_NO_LEASE;
    }
    if (!valid(g->enabled_nonce, now) || g->limit <= 0) {
        return GATE_NO_ENABLE;
    }
    if (!valid(g->command_nonce, now)) {
        return GATE_NO_COMMAND;
    }
    return exceeds(larger(magnitude(g->left), magnitude(g->right)), g->limit) ? GATE_NO_ENABLE : GATE_OPEN;
}

void gate_init(struct gate *g, uint32_t boot_id, uint8_t latch, uint32_t latch_id, uint32_t now)
{
    *g = (struct gate){
        .boot_id = boot_id,
        .latch = latch,
        .latch_id = latch_id,
        .at = now,
        .target_after = GATE_UNKNOWN,
        .output_after = GATE_UNKNOWN,
        .status = GATE_NO_LEASE,
    };
}

int8_t gate_step(struct gate *g, const struct gate_limits *limits, const struct gate_inputs *i, uint32_t now)
{
    int8_t granted = LEASE_NOT_ASKED;

    if (now < g->at) {
        start_anew(g, now);
    } else if (now - g->at > GATE_VALID_MS && !(gate_stands(g) && target_stands(g))) {
        follow(g, 0, 0, UINT32_MAX, now); /* nobody asked the gate while it let its wheels turn: they stand now */
        g->since = now;
    }
    const bool at_rest = gate_stands(g) && !i->turning;
    if (i->latch != LATCH_NONE) {
        close_by(g, i->latch);
    }
    if (i->permission) {
        take_permission(g, i, at_rest && i->latch == LATCH_NONE, now);
    }
    if (i->lease) {
        granted = take_lease(g, i->lease_session, i->lease_action, at_rest, now) ? LEASE_GRANTED : LEASE_REFUSED;
    }
    if (i->command) {
        take_command(g, limits, i, now);
    }
    g->status = (uint8_t)judged(g, now);
    const bool open = g->status == GATE_OPEN;
    follow(g, open ? g->left : 0, open ? g->right : 0, reached(g, limits, now), now);
    return granted;
}

static int8_t direction(int32_t output, int16_t measured)
{
    const int32_t eighths = (int32_t)measured * GATE_SPEED_TO_OUTPUT * 8; /* of the speed [2^-16 rad/s] */
    const int32_t allowed = output * RUNAWAY_FASTER;
    const int32_t turning = (int32_t)RUNAWAY_TURNING * GATE_SPEED_TO_OUTPUT * 8;

    if (eighths > turning && eighths - turning > allowed) {
        return 1;
    }
    return eighths < -turning && eighths + turning < allowed ? -1 : 0;
}

bool runaway_look(struct runaway *r, int32_t output, int16_t measured, uint32_t now)
{
    const bool continuous = r->looked <= now && now - r->looked <= RUNAWAY_LOOKED_WITHIN_MS;
    const int8_t after = direction(output, measured);

    if (after == 0 || after == -r->direction || !continuous) {
        r->since = now;
    }
    r->direction = after;
    r->looked = now;
    return now - r->since >= RUNAWAY_RESTS_WITHIN_MS;
}
