/* Notches that follow the loudest tones of each axis: the rotors' vibration, whatever their speed.
 *
 * Method: a bank of Goertzel filters (Goertzel 1958) measures NOTCH_BINS frequencies of one axis at a time over a
 * window of samples under Hann's weight; the largest peaks, refined between bins by the ratio of neighbours (Grandke
 * 1983), become the notches' centres. Then comes the next axis. Every sample does one step of this: it updates all
 * bins, or reads a third of them, or finds a peak, or places a notch. None costs more than updating the bins, so the
 * cost of a sample is bounded. */
#pragma once

#include "nf_contract.h"
#include "sensing/svf.h"

#define NOTCH_MAX 3   /* an axis: the setting's limit */
#define NOTCH_BINS 24

struct dynamic_notch {
	uint8_t count;           /* notches per axis, 0: off */
	uint8_t axis;            /* being listened to */
	uint8_t placed;          /* bit field: this axis' notches that have a peak of this window */
	uint8_t peak;            /* bin of the largest peak left; 0: none */
	uint16_t window;         /* samples */
	uint16_t position;       /* in the window, and behind it the steps that follow */
	float damping;           /* 1 / Q */
	float low_turns, spacing; /* of the first bin and from bin to bin [turns a sample] */
	float first, step, before; /* 2 cos of the first bin, of the spacing, of a bin before the first */
	float hann, hann_before; /* cos of the turn that the window is, at this sample and at the one before */
	float loudest, total;    /* power of the largest peak of this window; of all bins that are left */
	float s1[NOTCH_BINS], s2[NOTCH_BINS]; /* Goertzel's memory; once read, s1 are powers */
	struct svf notch[3][NOTCH_MAX];
	struct svf_memory memory[3][NOTCH_MAX];
};

/* From the settings dynamic_notch_*. Centres stay between low and high; low is brought at least 100 Hz below high,
 * and high to at most 0.45 of the gyro rate. */
void dynamic_notch_init(struct dynamic_notch *d, const struct nf_settings *settings, unsigned gyro_rate_hz);

/* One gyro sample, in place [rad/s]. */
void dynamic_notch_step(struct dynamic_notch *d, float rate[3]);
