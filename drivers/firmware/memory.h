/* What outlasts a restart: the latch, and the number of starts. Two slots in the board's EEPROM, written in turn.
 *
 * A slot: latch (1 byte, written first), latch id, boot id, sequence (4 bytes each), CRC-32 of these.
 * A write that was interrupted leaves the other slot whole. The graver one of both latches counts then.
 */
#ifndef ROBOFLEET_MEMORY_H
#define ROBOFLEET_MEMORY_H

#include <stdbool.h>
#include <stdint.h>

#define MEMORY_SLOT_BYTES 17u

struct kept {
    uint8_t latch; /* enum gate_latch, never a drill */
    uint32_t latch_id;
    uint32_t boot_id; /* of the newest start: each has its own */
};

struct memory {
    struct kept newest;  /* in the memory, or on its way */
    struct kept wanted;
    uint32_t sequence;
    uint8_t slot;        /* that is written, or will be */
    uint8_t bytes[MEMORY_SLOT_BYTES];
    uint8_t at;          /* byte that is written next; MEMORY_SLOT_BYTES: none */
    bool pending;        /* the last byte has not been looked at yet */
    bool broken;         /* it did not keep what was written */
};

/* Read what was kept, count the start, and write that: waits for the memory, some 70 ms. */
struct kept memory_start(struct memory *m);

/* Keep this: written byte by byte by the following calls. */
void memory_keep(struct memory *m, uint8_t latch, uint32_t latch_id);

/* Write the next byte, if the memory is ready. */
void memory_step(struct memory *m);

#endif
