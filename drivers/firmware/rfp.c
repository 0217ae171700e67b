#include "rfp.h"

/* CRC-32 of the sixteen nibbles: 64 bytes of memory, twice as fast as bit by bit. */
static const uint32_t nibbles[16] = {
    0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
    0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
};

uint32_t rfp_crc(const uint8_t *bytes, uint8_t length)
{
    uint32_t crc = UINT32_MAX;

    for (uint8_t k = 0u; k < length; k++) {
        crc ^= bytes[k];
        crc = (crc >> 4) ^ nibbles[crc & 15u];
        crc = (crc >> 4) ^ nibbles[crc & 15u];
    }
    return ~crc;
}

uint8_t rfp_u8(const uint8_t *body, uint8_t at)
{
    return body[at];
}

uint16_t rfp_u16(const uint8_t *body, uint8_t at)
{
    return (uint16_t)(body[at] | (uint16_t)body[at + 1u] << 8);
}

uint32_t rfp_u32(const uint8_t *body, uint8_t at)
{
    return rfp_u16(body, at) | (uint32_t)rfp_u16(body, (uint8_t)(at + 2u)) << 16;
}

/* Undo COBS in place. Returns the length; 0 where a code byte points behind the end. */
static uint8_t uncobs(uint8_t *bytes, uint8_t length)
{
    uint8_t from = 0u;
    uint8_t to = 0u;

    while (from < length) {
        const uint8_t code = bytes[from];
        from++;
        if (code > length - from + 1u) {
            return 0u;
        }
        for (uint8_t k = 1u; k < code; k++) {
            bytes[to] = bytes[from];
            to++;
            from++;
        }
        if (from < length) { /* lines are shorter than 255 bytes: each code but the last one stands for a zero */
            bytes[to] = 0u;
            to++;
        }
    }
    return to;
}

static uint8_t struck(struct rfp_receiver *r)
{
    r->struck++;
    return 0u;
}

uint8_t rfp_receive(struct rfp_receiver *r, uint8_t byte)
{
    if (byte != 0u) {
        if (r->length < RFP_LINE_BYTES - 1u) {
            r->bytes[r->length] = byte;
            r->length++;
        } else {
            r->overrun = true;
        }
        return 0u;
    }
    const uint8_t length = r->length;
    const bool overrun = r->overrun;
    r->length = 0u;
    r->overrun = false;
    if (length == 0u) {
        return 0u; /* two delimiters in a row: a host may begin with one */
    }
    const uint8_t whole = uncobs(r->bytes, length);
    if (overrun || whole <= RFP_CRC_BYTES) {
        return struck(r);
    }
    const uint8_t body = (uint8_t)(whole - RFP_CRC_BYTES);
    if (rfp_u32(r->bytes, body) != rfp_crc(r->bytes, body)) {
        return struck(r);
    }
    const uint8_t count = r->bytes[0] & 15u;
    if (r->heard) {
        r->lost = (uint16_t)(r->lost + ((count - r->count - 1u) & 15u));
    }
    r->heard = true;
    r->count = count;
    return body;
}

uint8_t rfp_frame(uint8_t *line, const uint8_t *body, uint8_t length)
{
    const uint32_t crc = rfp_crc(body, length);
    uint8_t code = 0u; /* where the code byte of the present group stands */
    uint8_t to = 1u;

    for (uint8_t k = 0u; k < length + RFP_CRC_BYTES; k++) {
        const uint8_t byte = k < length ? body[k] : (uint8_t)(crc >> 8u * (uint8_t)(k - length));
        if (byte == 0u) {
            line[code] = (uint8_t)(to - code);
            code = to;
        } else {
            line[to] = byte;
        }
        to++;
    }
    line[code] = (uint8_t)(to - code);
    line[to] = 0u;
    return (uint8_t)(to + 1u);
}

static uint8_t *put8(uint8_t *to, uint8_t value)
{
    *to = value;
    return to + 1;
}

static uint8_t *put16(uint8_t *to, uint16_t value)
{
    return put8(put8(to, (uint8_t)value), (uint8_t)(value >> 8));
}

static uint8_t *put32(uint8_t *to, uint32_t value)
{
    return put16(put16(to, (uint16_t)value), (uint16_t)(value >> 16));
}

static uint8_t *put_text(uint8_t *to, const char *text, uint8_t room)
{
    for (uint8_t k = 0u; k < room; k++) {
        to = put8(to, (uint8_t)*text);
        if (*text != '\0') {
            text++;
        }
    }
    return to;
}

static uint8_t *put_head(uint8_t *to, enum rfp_type type, uint8_t count)
{
    return put8(to, (uint8_t)((unsigned)type << 4 | (count & 15u)));
}

uint8_t rfp_put_identity(uint8_t *body, uint8_t count, const struct rfp_identity *m)
{
    uint8_t *to = put_head(body, RFP_IDENTITY, count);
    to = put8(to, RFP_VERSION);
    to = put_text(to, m->board, RFP_BOARD_CHARS);
    to = put_text(to, m->build, RFP_BUILD_CHARS);
    to = put32(to, m->hash);
    to = put8(to, m->reset);
    return (uint8_t)(to - body);
}

uint8_t rfp_put_status(uint8_t *body, uint8_t count, const struct rfp_status *m)
{
    uint8_t *to = put_head(body, RFP_STATUS, count);
    to = put32(to, m->boot_id);
    to = put32(to, m->nonce);
    to = put32(to, (uint32_t)m->count_left);
    to = put32(to, (uint32_t)m->count_right);
    to = put16(to, (uint16_t)m->speed_left);
    to = put16(to, (uint16_t)m->speed_right);
    to = put16(to, (uint16_t)m->output_left);
    to = put16(to, (uint16_t)m->output_right);
    to = put8(to, m->gate);
    to = put8(to, m->latch);
    to = put8(to, m->faults);
    to = put8(to, m->felt);
    return (uint8_t)(to - body);
}

uint8_t rfp_put_health(uint8_t *body, uint8_t count, const struct rfp_health *m)
{
    uint8_t *to = put_head(body, RFP_HEALTH, count);
    to = put16(to, m->epoch);
    to = put32(to, m->session);
    to = put32(to, m->latch_id);
    to = put16(to, m->refused);
    to = put16(to, m->struck);
    to = put16(to, m->lost);
    to = put16(to, m->battery);
    to = put16(to, (uint16_t)m->current_left);
    to = put16(to, (uint16_t)m->current_right);
    to = put16(to, (uint16_t)m->target_after);
    to = put16(to, (uint16_t)m->output_after);
    to = put16(to, m->loop_us);
    to = put8(to, m->memory);
    to = put8(to, m->reset);
    return (uint8_t)(to - body);
}

uint8_t rfp_put_lease_answer(uint8_t *body, uint8_t count, uint32_t session, uint16_t epoch, bool granted)
{
    uint8_t *to = put_head(body, RFP_LEASE_ANSWER, count);
    to = put32(to, session);
    to = put16(to, epoch);
    to = put8(to, granted ? 1u : 0u);
    return (uint8_t)(to - body);
}

uint8_t rfp_put_settings(uint8_t *body, uint8_t count, const struct rfp_settings *m)
{
    uint8_t *to = put_head(body, RFP_SETTINGS, count);
    to = put32(to, m->counts);
    to = put32(to, m->radius);
    to = put16(to, (uint16_t)m->max_wheel);
    to = put16(to, m->max_sum);
    to = put16(to, m->max_ramp);
    to = put16(to, m->gains.kp);
    to = put16(to, m->gains.ki);
    to = put16(to, m->gains.kff);
    return (uint8_t)(to - body);
}
