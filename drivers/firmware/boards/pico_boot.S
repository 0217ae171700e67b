/* The second stage of the Pico's start: its boot ROM runs these 256 bytes if their checksum is right (tests hold it).
 * They let the flash be read in place, with the command that every flash knows, and go on there. */
    .syntax unified
    .cpu cortex-m0plus
    .thumb
    .section .boot2, "ax"

    ldr r0, =0x4005b000     /* what a register of the watchdog shall lose */
    ldr r1, =1 << 30
    str r1, [r0]            /* CTRL: not enabled: it may be what reset the chip */
    ldr r0, =0x18000000     /* the flash's serial interface */
    movs r1, #0
    str r1, [r0, #0x08]     /* SSIENR: off while it is set up */
    str r1, [r0, #0x04]     /* CTRLR1: one word at a time */
    movs r1, #4
    str r1, [r0, #0x14]     /* BAUDR: a quarter of the clock */
    movs r1, #1
    str r1, [r0, #0x10]     /* SER: this flash */
    ldr r1, =31 << 16 | 3 << 8
    str r1, [r0, #0x00]     /* CTRLR0: words of 32 bits, by a command and an address */
    ldr r1, =0x03 << 24 | 2 << 8 | 6 << 2
    ldr r2, =0x180000f4
    str r1, [r2]            /* SPI_CTRLR0: read, with an address of 24 bits */
    movs r1, #1
    str r1, [r0, #0x08]     /* SSIENR: on */
    ldr r0, =0x10000101     /* what is linked behind */
    bx r0
    .ltorg
    .balign 4
    .org 252
    .word 0x1c550920        /* CRC-32 of the bytes before, as the boot ROM computes it */
