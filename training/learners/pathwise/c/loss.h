/* The loss of a block's flight and its derivatives by rates, outputs and motors. */
#ifndef LOSS_H
#define LOSS_H

#include "tape.h"

enum { FIGURE_MAE, FIGURE_MSE, FIGURE_OUTPUT, FIGURE_CHANGE, FIGURE_CLOSED, FIGURES };

/* Figures of each lane. */
struct figures {
	double of[FIGURES][LANES];
};

void loss_add(struct figures *f, const struct plan *p, const struct block *b, const struct tape *t, size_t k,
	      const real *action, const real *action_before);
void loss_sum(const struct figures *f, double *figures);
void loss_back_rate(const struct plan *p, const struct block *b, const struct tape *t, size_t k, real *by_rate);
void loss_back_action(const struct plan *p, const struct block *b, const struct tape *t, size_t k, real *by_action,
		      real *by_motors);

#endif
