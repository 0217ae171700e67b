#include "memory.h"

#include "board.h"
#include "gate.h"
#include "rfp.h"

#define SLOTS 2u
#define CRC_AT (MEMORY_SLOT_BYTES - RFP_CRC_BYTES)

static void read_slot(uint8_t slot, uint8_t *bytes)
{
    for (uint8_t k = 0u; k < MEMORY_SLOT_BYTES; k++) {
        bytes[k] = board_eeprom_read((uint8_t)(slot * MEMORY_SLOT_BYTES + k));
    }
}

static bool whole(const uint8_t *bytes)
{
    return rfp_u32(bytes, CRC_AT) == rfp_crc(bytes, CRC_AT);
}

static bool blank(const uint8_t *bytes)
{
    for (uint8_t k = 0u; k < MEMORY_SLOT_BYTES; k++) {
        if (bytes[k] != 0xFFu) {
            return false;
        }
    }
    return true;
}

static void put32(uint8_t *bytes, uint8_t at, uint32_t value)
{
    for (uint8_t k = 0u; k < 4u; k++) {
        bytes[at + k] = (uint8_t)(value >> 8u * k);
    }
}

static void begin(struct memory *m)
{
    m->newest = m->wanted;
    m->sequence++;
    m->bytes[0] = m->newest.latch;
    put32(m->bytes, 1u, m->newest.latch_id);
    put32(m->bytes, 5u, m->newest.boot_id);
    put32(m->bytes, 9u, m->sequence);
    put32(m->bytes, CRC_AT, rfp_crc(m->bytes, CRC_AT));
    m->at = 0u;
    m->pending = true;
}

static bool same(const struct kept *a, const struct kept *b)
{
    return a->latch == b->latch && a->latch_id == b->latch_id; /* the boot id is that of this start */
}

static void verify(struct memory *m)
{
    uint8_t bytes[MEMORY_SLOT_BYTES];

    read_slot(m->slot, bytes);
    for (uint8_t k = 0u; k < MEMORY_SLOT_BYTES; k++) {
        if (bytes[k] != m->bytes[k]) {
            m->broken = true;
        }
    }
    m->pending = false;
    m->slot = (uint8_t)(1u - m->slot);
}

void memory_step(struct memory *m)
{
    if (!board_eeprom_ready()) {
        return;
    }
    if (!m->pending) {
        if (!same(&m->wanted, &m->newest)) {
            begin(m);
        }
        return;
    }
    if (m->at == MEMORY_SLOT_BYTES) {
        verify(m);
        return;
    }
    const uint8_t address = (uint8_t)(m->slot * MEMORY_SLOT_BYTES + m->at);
    if (board_eeprom_read(address) != m->bytes[m->at]) { /* what stands there already is not worn */
        board_eeprom_write(address, m->bytes[m->at]);
    }
    m->at++;
}

void memory_keep(struct memory *m, uint8_t latch, uint32_t latch_id)
{
    m->wanted.latch = latch == LATCH_DRILL ? LATCH_NONE : latch;
    m->wanted.latch_id = latch_id;
}

struct kept memory_start(struct memory *m)
{
    uint8_t slots[SLOTS][MEMORY_SLOT_BYTES];
    struct kept kept = {0};

    *m = (struct memory){0};
    read_slot(0u, slots[0]);
    read_slot(1u, slots[1]);
    const bool first = whole(slots[0]);
    const bool second = whole(slots[1]);
    if (first || second) {
        const bool second_is_newest = second && (!first || rfp_u32(slots[1], 9u) > rfp_u32(slots[0], 9u));
        const uint8_t newest = second_is_newest ? 1u : 0u;
        const uint8_t *bytes = slots[newest];
        const uint8_t *other = slots[1u - newest];
        kept.latch = bytes[0];
        kept.latch_id = rfp_u32(bytes, 1u);
        kept.boot_id = rfp_u32(bytes, 5u);
        m->sequence = rfp_u32(bytes, 9u);
        m->slot = (uint8_t)(1u - newest);
        if (!(first && second) && !blank(other)) { /* a write was interrupted: its first byte says of which latch */
            const uint8_t latch = other[0] <= LATCH_RUNAWAY ? other[0] : LATCH_MEMORY_LOST;
            if (latch > kept.latch) {
                kept.latch = latch;
                kept.latch_id++;
            }
        }
    } else if (!(blank(slots[0]) && blank(slots[1]))) {
        kept.latch = LATCH_MEMORY_LOST;
        kept.latch_id = rfp_crc(slots[0], MEMORY_SLOT_BYTES); /* numbers that were hardly given out before */
        kept.boot_id = rfp_crc(slots[1], MEMORY_SLOT_BYTES) ^ kept.latch_id << 1;
    }
    kept.boot_id++;
    m->wanted = kept;
    begin(m);
    while (m->pending) {
        board_watchdog_kick();
        memory_step(m);
    }
    return kept;
}
