/* toolchain/ir/activation_tables.py's arithmetic in C, and its worst errors over every float32 of one sign. */
#include <math.h>
#include <stdint.h>
#include <string.h>

struct worst {
    double ulp;            /* of the exact result's binade */
    double absolute;
    double largest;        /* |result| */
    double fall_ulp;       /* |result| below the largest so far, as |x| grows */
    double step_back_ulp;  /* |result| below that of the float before */
    float at;              /* x of the worst ulp */
};

static uint32_t bits_of(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static float value_of(uint32_t bits)
{
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static float lookup(const float (*rows)[4], float low, float high, float step, int even, float x)
{
    const float magic = 12582912.0f * step;
    const float not_finite = x * 0.0f; /* NaN of NaN and of infinities */
    x = x <= high ? x : high;
    x = x > low ? x : low;
    const float a = fabsf(x);
    const float total = a + magic;
    const float r = a - (total - magic) + not_finite;
    const float *c = rows[bits_of(total) - bits_of(magic)];
    const float quotient = fmaf(fmaf(fmaf(c[3], r, c[2]), r, c[1]), r, c[0]);
    return even ? quotient : x * quotient;
}

void lookup_all(const float (*rows)[4], float low, float high, float step, int even,
                const float *x, float *y, int n)
{
    for (int i = 0; i < n; i++) {
        y[i] = lookup(rows, low, high, step, even, x[i]);
    }
}

/* libm's double results stand for the exact ones: their error is below 1e-8 ulp of float32. */
void lookup_every(const float (*rows)[4], float low, float high, float step, int even, int function,
                  int negative, struct worst *worst)
{
    float before = 0.0f, top = 0.0f;
    for (uint32_t magnitude = 0; magnitude < 0x7F800000u; magnitude++) {
        const float x = value_of(magnitude | (negative ? 0x80000000u : 0u));
        const float result = lookup(rows, low, high, step, even, x);
        const double exact = function == 2 ? erf((double)x)
                             : function == 1 ? tanh((double)x)
                             : x > 0.0f ? 0.0 : expm1((double)x);
        int exponent;
        frexp(exact, &exponent);
        const double last_place = ldexp(1.0, exponent < -125 ? -149 : exponent - 24);
        const double error = fabs((double)result - exact);
        const float size = fabsf(result);
        if (error / last_place > worst->ulp) {
            worst->ulp = error / last_place;
            worst->at = x;
        }
        worst->absolute = fmax(worst->absolute, error);
        worst->step_back_ulp = fmax(worst->step_back_ulp, (double)(before - size) / last_place);
        worst->fall_ulp = fmax(worst->fall_ulp, (double)(top - size) / last_place);
        before = size;
        top = fmaxf(top, size);
    }
    worst->largest = (double)top;
}
