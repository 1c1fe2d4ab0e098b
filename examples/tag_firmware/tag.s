; SPDX-License-Identifier: GPL-3.0-or-later
; The two clocks of a tag on an ATtiny85 with a crystal of 4 MHz: PB0 drives the switch of end 1, PB1 that of end 2.
;
; A period has 16 slots. Timer 0 begins each of them and wakes the processor, which always sleeps by then: from the
; timer to the pins it is the same number of cycles in every slot, so that edges have no jitter but the crystal's.
; What comes after the pins are set may take as long as it wants, up to one slot.
;
; avr-as -mmcu=attiny85 [--defsym SLOT=250] [--defsym PRESCALER=1] tag.s -o tag.o
; avr-ld -m avr25 tag.o -o tag.elf
; avrdude -c usbasp -p t85 -U lfuse:w:0xfd:m -U flash:w:tag.elf:e
;
; `gr-wiforce design --clock-hz HERTZ` prints SLOT and PRESCALER of a clock. Low fuse 0xfd: crystal of 3 to 8 MHz, long
; start-up, no division by 8 (data sheet 2586Q, tables 6-5, 6-6 and 20-5).

.ifndef SLOT
.equ SLOT, 250          ; timer steps of a slot, 64 to 256: 4 MHz / 16 / 250 is 1000 Hz
.endif
.ifndef PRESCALER
.equ PRESCALER, 1       ; TCCR0B: 1, the timer steps with the crystal; 2, once in eight cycles
.endif

; Registers of the ATtiny85 by their I/O addresses (data sheet, chapter 26).
.equ ACSR, 0x08
.equ DDRB, 0x17
.equ PORTB, 0x18
.equ PRR, 0x20
.equ OCR0A, 0x29
.equ TCCR0A, 0x2a
.equ TCCR0B, 0x33
.equ MCUCR, 0x35
.equ TIMSK, 0x39
.equ SPL, 0x3d
.equ SPH, 0x3e
.equ RAMEND, 0x25f

.section .text
vectors:
    rjmp start
    .rept 9
    rjmp start          ; never enabled
    .endr
    ; Timer 0, compare match A, the eleventh vector: its code may lie here, as no later one is used.
slot:
    out PORTB, r16
    lpm r16, Z+         ; what the next slot shows
    cpi r30, lo8(pulses_end)
    brne 1f
    ldi r30, lo8(pulses)
1:  reti

start:
    ldi r16, lo8(RAMEND)
    out SPL, r16
    ldi r16, hi8(RAMEND)
    out SPH, r16
    ldi r16, 0x3c       ; PB2 to PB5 are inputs with pull-ups
    out PORTB, r16
    ldi r16, 0x03
    out DDRB, r16
    ldi r16, 0x80       ; the comparator is off
    out ACSR, r16
    ldi r16, 0x0b       ; timer 1, serial interface and converter are off
    out PRR, r16
    ldi r16, 0x02       ; the timer begins again after a match
    out TCCR0A, r16
    ldi r16, SLOT - 1
    out OCR0A, r16
    ldi r16, 0x10       ; interrupt by compare match A
    out TIMSK, r16
    ldi r16, 0x20       ; sleep is possible: idle, in which the timer runs
    out MCUCR, r16
    ldi r30, lo8(pulses)
    ldi r31, hi8(pulses)
    lpm r16, Z+
    ldi r17, PRESCALER
    out TCCR0B, r17
    sei
1:  sleep
    rjmp 1b

; Pins in each sixteenth of a period, from the centre of a pulse of clock 1. Clock 1 is high for a quarter around 0, clock
; 2 for an eighth around a quarter and three quarters; they are never high together. 0x3c keeps the pull-ups.
.balign 32              ; all in one page of 256 bytes, as only the low byte of Z is compared
pulses:
    .byte 0x3d, 0x3d, 0x3c, 0x3e, 0x3e, 0x3c, 0x3c, 0x3c
    .byte 0x3c, 0x3c, 0x3c, 0x3e, 0x3e, 0x3c, 0x3d, 0x3d
pulses_end:
