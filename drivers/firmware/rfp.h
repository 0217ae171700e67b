/* rfp/1, the line protocol between a host and a robot: RFP.md describes it. Freestanding C11.
 *
 * A frame on the line: COBS(head, fields, CRC-32), 0x00. At most 64 bytes. Fields are little-endian.
 */
#ifndef ROBOFLEET_RFP_H
#define ROBOFLEET_RFP_H

#include <stdbool.h>
#include <stdint.h>

#define RFP_VERSION 1u
#define RFP_LINE_BYTES 64u                    /* of a frame, with its delimiter */
#define RFP_CRC_BYTES 4u
#define RFP_BODY_BYTES (RFP_LINE_BYTES - 2u - RFP_CRC_BYTES) /* head and fields */
#define RFP_BOARD_CHARS 12u
#define RFP_BUILD_CHARS 16u

/* The high nibble of the head is the type; the low one counts the sender's frames. Bit 7: from the robot. */
enum rfp_type {
    RFP_HELLO = 1,
    RFP_COMMAND = 2,
    RFP_PERMISSION = 3,
    RFP_LEASE = 4,
    RFP_GAINS = 5,
    RFP_IDENTITY = 9,
    RFP_STATUS = 10,
    RFP_HEALTH = 11,
    RFP_LEASE_ANSWER = 12,
    RFP_SETTINGS = 13
};

/* Bytes of head and fields. */
#define RFP_HELLO_BYTES 1u
#define RFP_COMMAND_BYTES 23u
#define RFP_PERMISSION_BYTES 22u
#define RFP_LEASE_BYTES 6u
#define RFP_GAINS_BYTES 7u
#define RFP_IDENTITY_BYTES 35u
#define RFP_STATUS_BYTES 29u
#define RFP_HEALTH_BYTES 31u
#define RFP_LEASE_ANSWER_BYTES 8u
#define RFP_SETTINGS_BYTES 21u

/* Gains of the speed loop of a wheel (robot.h). */
struct rfp_gains {
    uint16_t kp;
    uint16_t ki;
    uint16_t kff;
};

struct rfp_identity {
    const char *board; /* zero-terminated */
    const char *build; /* zero-terminated */
    uint32_t hash;     /* of the sources */
    uint8_t reset;     /* why the board started: enum board_reset */
};

struct rfp_status {
    uint32_t boot_id;
    uint32_t nonce;
    int32_t count_left;
    int32_t count_right;
    int16_t speed_left;
    int16_t speed_right;
    int16_t output_left;
    int16_t output_right;
    uint8_t gate;   /* enum gate_status */
    uint8_t latch;  /* enum gate_latch */
    uint8_t faults; /* enum board_fault: those that last */
    uint8_t felt;   /* and those that were felt since the gate was latched */
};

struct rfp_health {
    uint16_t epoch;
    uint32_t session;
    uint32_t latch_id;
    uint16_t refused; /* by the gate */
    uint16_t struck;  /* frames that were no frames */
    uint16_t lost;    /* frames that the count says are missing */
    uint16_t battery; /* [mV]; 0: not measured */
    int16_t current_left; /* [mA]; 0 where not measured */
    int16_t current_right;
    int16_t target_after; /* last stop [ms]; -1: none */
    int16_t output_after;
    uint16_t loop_us; /* the longest loop since the start */
    uint8_t memory;   /* 1: it cannot keep a latch */
    uint8_t reset;    /* why the board started: enum board_reset */
};

struct rfp_settings {
    uint32_t counts; /* of a turn of a wheel [2^-8] */
    uint32_t radius; /* of a wheel [um] */
    int16_t max_wheel; /* as struct gate_limits */
    uint16_t max_sum;
    uint16_t max_ramp;
    struct rfp_gains gains;
};

/* Takes bytes, gives frames. Begin with zeros. */
struct rfp_receiver {
    uint8_t bytes[RFP_LINE_BYTES];
    uint8_t length;
    bool overrun;    /* since the last delimiter there were too many bytes */
    bool heard;      /* there was a frame */
    uint8_t count;   /* of the last frame */
    uint16_t struck;
    uint16_t lost;
};

/* CRC-32 as Ethernet's and zlib's. */
uint32_t rfp_crc(const uint8_t *bytes, uint8_t length);

/* Take one byte. Returns the bytes of head and fields of a whole frame, at `bytes`; 0: there is none yet. */
uint8_t rfp_receive(struct rfp_receiver *r, uint8_t byte);

/* Make a frame of head and fields. `line` has RFP_LINE_BYTES; returns how many of them are used. */
uint8_t rfp_frame(uint8_t *line, const uint8_t *body, uint8_t length);

/* Write head and fields to `body` (RFP_BODY_BYTES); return how many bytes. `count`: of frames sent. */
uint8_t rfp_put_identity(uint8_t *body, uint8_t count, const struct rfp_identity *m);
uint8_t rfp_put_status(uint8_t *body, uint8_t count, const struct rfp_status *m);
uint8_t rfp_put_health(uint8_t *body, uint8_t count, const struct rfp_health *m);
uint8_t rfp_put_lease_answer(uint8_t *body, uint8_t count, uint32_t session, uint16_t epoch, bool granted);
uint8_t rfp_put_settings(uint8_t *body, uint8_t count, const struct rfp_settings *m);

/* Read a number of a body, beginning at its byte `at`. */
uint8_t rfp_u8(const uint8_t *body, uint8_t at);
uint16_t rfp_u16(const uint8_t *body, uint8_t at);
uint32_t rfp_u32(const uint8_t *body, uint8_t at);

#endif
