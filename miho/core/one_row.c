/* Functions of one row or number at a time, which all levels share. Large angles: x times 2 / pi
   with 192 bits after the whole turns (Payne and Hanek 1983). */
#define WIDTH 1
#include "operations.h"

#define WORDS 6

double exp_one(double x) {
    exp_of_rows(&x, &x, 1);
    return x;
}

double log_one(double x) {
    log_of_rows(&x, &x, 1);
    return x;
}

void run_one_row(const instruction *from, const instruction *to, double *const *registers,
                 const double *scalars) {
    for (const instruction *q = from; q < to; q++) operate(q, registers, scalars, 1);
}

/* Product modulo 4 of a large x and 2 / pi, as a number of 192 bits, two of them whole, with the
   highest word first. */
static void times_two_over_pi(double x, uint32_t fraction[WORDS]) {
    static const uint32_t table[TWO_OVER_PI_WORDS] = {TWO_OVER_PI};
    /* x = mantissa 2^e. Bits of 2 / pi above 2^(1-e) make multiples of four. */
    uint64_t mantissa = (bits_of(x) & MANTISSA) | 0x0010000000000000ull;
    int e = (int)((bits_of(x) >> 52) & 0x7ff) - 1075, first = e - 2 + 64;
    uint32_t window[WORDS];
    for (int k = 0; k < WORDS; k++) {
        int word = first / 32 + k, shift = first % 32;
        uint64_t two = ((uint64_t)table[word] << 32) | table[word + 1];
        window[k] = (uint32_t)(two >> (32 - shift));
    }
    /* By words of 32 bits, from the lowest; carries beyond the highest word are whole turns. */
    uint64_t low = mantissa & 0xffffffffu, high = mantissa >> 32, carry = 0;
    for (int k = WORDS - 1; k >= 0; k--) {
        uint64_t a = low * window[k], b = k + 1 < WORDS ? high * window[k + 1] : 0;
        uint64_t sum = (carry & 0xffffffffu) + (a & 0xffffffffu) + (b & 0xffffffffu);
        fraction[k] = (uint32_t)sum;
        carry = (carry >> 32) + (a >> 32) + (b >> 32) + (sum >> 32);
    }
}

/* About 53 bits of a number of 192 bits, starting at bit `from`. */
static double bits_from(const uint32_t number[WORDS], int from) {
    double value = 0.0;
    for (int bit = from; bit < from + 53 && bit < 32 * WORDS; bit++)
        if (number[bit / 32] >> (31 - bit % 32) & 1) value += two_to(-bit - 1);
    return value;
}

/* `quarter_turns` for a finite x of any size from SMALL_ANGLE on. */
static uint64_t large_quarter_turns(double x, double *r, double *rest) {
    uint32_t fraction[WORDS];
    times_two_over_pi(x, fraction);
    uint64_t n = fraction[0] >> 30;
    int beyond = fraction[0] >> 29 & 1; /* more than half a quarter: count back from the next one */
    for (int k = 0; k < WORDS; k++) {
        uint32_t next = k + 1 < WORDS ? fraction[k + 1] : 0;
        fraction[k] = fraction[k] << 2 | next >> 30;
        if (beyond) fraction[k] = ~fraction[k];
    }
    int first = 0;
    while (first < 32 * WORDS - 1 && !(fraction[first / 32] >> (31 - first % 32) & 1)) first++;
    double sign = (beyond ? -1.0 : 1.0) * (x < 0.0 ? -1.0 : 1.0);
    double turn = bits_from(fraction, first), turn_rest = bits_from(fraction, first + 53);
    double lost, p = product(turn, PI_HALF_0, &lost);
    lost = lost + (turn * PI_HALF_1 + turn_rest * PI_HALF_0);
    *r = sign * (p + lost);
    *rest = sign * ((p - (p + lost)) + lost);
    n += (uint64_t)beyond;
    return x < 0.0 ? 4 - (n & 3) : n;
}

double sine_cosine_one(double x, double *cosine) {
    if (size_of(x) < SMALL_ANGLE) return small_sine_cosine(x, cosine);
    if (!(size_of(x) < INFINITE)) return *cosine = NOT_A_NUMBER;
    double r, rest;
    uint64_t n = large_quarter_turns(x, &r, &rest);
    return sine_cosine(n, r, rest, cosine);
}
