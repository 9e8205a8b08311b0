/* The answers of ESCs to frames of bidirectional DShot, out of samples of the lines that they come on.
 *
 * The line rests high. About 30 us after a frame an ESC sends 21 bits at 5/4 of the frame's bit rate: a low one, then
 * 20 in which a change of the line is a one and none a zero, and lets the line rest again. The 20 are four groups of
 * five, each a nibble (a group begins and ends with at most one zero and has at most two in a row), most significant
 * first: a word of 12 bits, then its checksum, the exclusive or of its nibbles, inverted. What the word means is
 * toolchain/contract/motors.py's to say. */
#pragma once

#include <stddef.h>
#include <stdint.h>

#define DSHOT_ANSWER_BITS 21u
#define DSHOT_ANSWER_OVERSAMPLING 3u /* samples a bit */
#define DSHOT_PORT_LINES 16u

/* An answer's last sample may be 10 % late, and a bit of rest has to follow it. */
#define DSHOT_ANSWER_SAMPLES 74u /* from its begin */

/* Decodes the answers on the lines of one port.
 * samples: two in each of the `pairs` words, the earlier one in the lower half, bit n of each the level of line n; the
 * first one is taken while all lines rest. pairs: at most 0x7FFF. earliest: an answer that begins before this sample is
 * none. lines: bit field of those to decode; their `words` alone are written: the 12 bits, NF_ESC_SILENT where the line
 * did not move, or NF_ESC_DAMAGED. learned: how long each line's bits are, beside 3 samples [1/65536 sample]; zeros before
 * the first answer, kept by the caller. It takes some answers to learn the length of an ESC whose bits are several
 * percent off; AM32's are 4 % too short to 9 % too long, by its processor (Mcu/<chip>/Src/IO.c: the output timer's period).
 * Refused as damaged: a line that does not rest before and after, a level shorter or longer than one to three bits, any
 * other number of bits, edges that lie on no grid of bits of the learned length, a group that stands for no nibble, a
 * wrong checksum. */
void dshot_telemetry_decode(const uint32_t samples[], size_t pairs, uint32_t earliest, uint32_t lines,
			    int16_t learned[DSHOT_PORT_LINES], uint16_t words[DSHOT_PORT_LINES]);
