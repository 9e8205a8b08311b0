/* The twin keeps the angular momentum h = I r in world axes (sim/physics/c/world.c). In the body's axes that is
 * h' = E (h + m dt/2) + m dt/2, where E undoes the turn of the sample, made at the rate in its middle,
 * r + dt/2 I^-1 (m - r x I r). With t the vector of that turn, E a = a - s t x a + c t x (t x a), where s and c are
 * sin |t| / |t| and (1 - cos |t|) / |t|^2, to the order at which single precision ends. */
#include "aircraft.h"

#define INLINE static inline __attribute__((always_inline))

struct vector {
	real x, y, z;
};

INLINE struct vector vector_at(const real *rows, size_t l)
{
	return (struct vector){rows[l], rows[LANES + l], rows[2 * LANES + l]};
}

INLINE void vector_put(real *rows, size_t l, struct vector v)
{
	rows[l] = v.x;
	rows[LANES + l] = v.y;
	rows[2 * LANES + l] = v.z;
}

INLINE struct vector cross(struct vector a, struct vector b)
{
	return (struct vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

INLINE real dot(struct vector a, struct vector b)
{
	return a.x * b.x + a.y * b.y + a.z * b.z;
}

/* a + f b */
INLINE struct vector plus(struct vector a, real f, struct vector b)
{
	return (struct vector){real_fma(f, b.x, a.x), real_fma(f, b.y, a.y), real_fma(f, b.z, a.z)};
}

INLINE struct vector times(real f, struct vector a)
{
	return (struct vector){f * a.x, f * a.y, f * a.z};
}

/* A symmetric matrix times a vector. */
INLINE struct vector map(const real *m, struct vector v)
{
	return (struct vector){m[0] * v.x + m[1] * v.y + m[2] * v.z, m[3] * v.x + m[4] * v.y + m[5] * v.z,
			       m[6] * v.x + m[7] * v.y + m[8] * v.z};
}

/* What forward and backward pass both need of a sample. */
struct turn {
	struct vector momentum, pushed, angle;
	real square, sine, cosine;
};

INLINE struct turn turn_of(const struct plan *p, struct vector moment, struct vector rate)
{
	const real half = R(0.5) * p->dt;
	struct turn t;

	t.momentum = map(p->body.inertia, rate);
	t.pushed = plus(t.momentum, half, moment);
	t.angle = times(p->dt, plus(rate, half, map(p->body.inverse, plus(moment, R(-1), cross(rate, t.momentum)))));
	t.square = dot(t.angle, t.angle);
	t.sine = R(1) - t.square / R(6);
	t.cosine = R(0.5) - t.square / R(24);
	return t;
}

/* Rates after a sample, rows (3). */
void body_turn(const struct plan *p, const real *restrict moment, const real *restrict rate, real *restrict after)
{
	FOR_LANES(l) {
		const struct vector m = vector_at(moment, l), r = vector_at(rate, l);
		const struct turn t = turn_of(p, m, r);
		/* Only what is gained is turned into a rate: rounding stays small against the rate. */
		struct vector gained = times(p->dt, m);

		gained = plus(gained, -t.sine, cross(t.angle, t.pushed));
		gained = plus(gained, t.cosine * dot(t.angle, t.pushed), t.angle);
		gained = plus(gained, -t.cosine * t.square, t.pushed);
		vector_put(after, l, plus(r, R(1), map(p->body.inverse, gained)));
	}
}

/* Derivatives by moment and rate before a sample, of those by the rate after it. */
void body_turn_back(const struct plan *p, const real *restrict moment, const real *restrict rate,
		    const real *restrict by_after, real *restrict by_moment, real *restrict by_rate)
{
	const real half = R(0.5) * p->dt;

	FOR_LANES(l) {
		const struct vector r = vector_at(rate, l), by = vector_at(by_after, l);
		const struct turn t = turn_of(p, vector_at(moment, l), r);
		const struct vector a = t.pushed, g = map(p->body.inverse, by);
		const real along_a = dot(t.angle, a), along_g = dot(t.angle, g), aligned = dot(g, a);
		/* By the momentum before the turn: E's transpose. */
		struct vector by_pushed = plus(g, t.sine, cross(t.angle, g));

		by_pushed = plus(by_pushed, t.cosine * along_g, t.angle);
		by_pushed = plus(by_pushed, -t.cosine * t.square, g);
		/* By the turn. */
		const struct vector swept = cross(a, g);
		struct vector by_angle = times(-t.sine, swept);

		by_angle = plus(by_angle, t.cosine * along_a, g);
		by_angle = plus(by_angle, t.cosine * along_g, a);
		by_angle = plus(by_angle,
				dot(t.angle, swept) / R(3) - R(2) * t.cosine * aligned -
					(along_g * along_a - aligned * t.square) / R(12),
				t.angle);
		const struct vector by_middle = times(p->dt, by_angle);
		const struct vector by_push = times(half, map(p->body.inverse, by_middle));
		struct vector rates = plus(map(p->body.inertia, by_pushed), R(1), by_middle);

		vector_put(by_moment, l, plus(plus(by_push, half, g), half, by_pushed));
		rates = plus(rates, R(-1), cross(t.momentum, by_push));
		rates = plus(rates, R(-1), map(p->body.inertia, cross(by_push, r)));
		vector_put(by_rate, l, rates);
	}
}
