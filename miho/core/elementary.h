/* Elementary functions without branches and tables, which the compiler vectorises.

   No product and sum is fused, and nothing comes from the mathematical library, so that results
   have the same bits on every processor and with every compiler. tests/core/test_elementary.py
   states the errors, in units in the last place. */
#ifndef MIHO_ELEMENTARY_H
#define MIHO_ELEMENTARY_H

#include <stdint.h>
#include <string.h>
#include "coefficients.h"

#define INLINE static inline __attribute__((always_inline))
#define INFINITE __builtin_inf()
#define NOT_A_NUMBER __builtin_nan("")
#define SIGN_BIT 0x8000000000000000ull
#define MANTISSA 0x000fffffffffffffull
#define TO_WHOLE 0x1.8p52       /* adding and subtracting it rounds to a whole number */
#define SMALL_ANGLE 0x1p20      /* up to here quarter turns times 33 bits are exact */
#define ROOT_HALF 0x3fe6a09e667f3bcdull /* the bits of sqrt(1/2) */

INLINE uint64_t bits_of(double x) { uint64_t bits; memcpy(&bits, &x, sizeof bits); return bits; }
INLINE double of_bits(uint64_t bits) { double x; memcpy(&x, &bits, sizeof x); return x; }
INLINE double size_of(double x) { return of_bits(bits_of(x) & ~SIGN_BIT); }
INLINE double with_sign(double size, double sign) {
    return of_bits((bits_of(size) & ~SIGN_BIT) | (bits_of(sign) & SIGN_BIT));
}
INLINE double to_whole(double x) { return (x + TO_WHOLE) - TO_WHOLE; }

/* 2^k for a whole k from -1022 to 1023. */
INLINE double two_to(double k) { return of_bits((bits_of(k + TO_WHOLE) + 1023) << 52); }

/* a b = product + rest, by splitting both factors (Dekker 1971). */
INLINE double product(double a, double b, double *rest) {
    double a1 = of_bits(bits_of(a) & 0xfffffffff8000000ull), a2 = a - a1;
    double b1 = of_bits(bits_of(b) & 0xfffffffff8000000ull), b2 = b - b1;
    double p = a * b;
    *rest = ((a1 * b1 - p) + a1 * b2 + a2 * b1) + a2 * b2;
    return p;
}

/* (e^r - 1 - r) / r^2 for |r| <= log(2) / 2. */
INLINE double exp_polynomial(double r) {
    double z = r * r, z2 = z * z;
    double a = EXP_1 * r + EXP_0, b = EXP_3 * r + EXP_2, c = EXP_5 * r + EXP_4;
    double d = EXP_7 * r + EXP_6, e = EXP_9 * r + EXP_8;
    return (z2 * z2) * e + (z2 * (z * d + c) + (z * b + a));
}

/* e^(x + rest) 2^shift. */
INLINE double exp_of_sum(double x, double rest, double shift) {
    double y = x > 712.0 ? 712.0 : x;
    y = y < -746.0 ? -746.0 : y;
    double k = to_whole(y * LN2_INVERSE_0);
    double r = (y - k * LN2_0) - (k * LN2_1 - rest);
    double p = 1.0 + (r * r * exp_polynomial(r) + r);
    double half = to_whole(k * 0.5); /* the result may be outside the range of 2^k */
    return p * two_to(half) * two_to((k - half) + shift);
}
INLINE double exp_of(double x) { return exp_of_sum(x, 0.0, 0.0); }

INLINE double expm1_of(double x) {
    double y = x > 712.0 ? 712.0 : x;
    y = y < -60.0 ? -60.0 : y;
    double k = to_whole(y * LN2_INVERSE_0);
    double r = (y - k * LN2_0) - k * LN2_1;
    double p = r * r * exp_polynomial(r) + r;
    double half = to_whole(k * 0.5), s = two_to(half), t = two_to(k - half);
    double large = (p + 1.0) * s * t, small = (s * t) * p + (s * t - 1.0);
    return x == 0.0 ? x : k > 1000.0 ? large : small;
}

/* x = 2^k m with m from sqrt(1/2) to sqrt(2), for a positive x. */
INLINE double split(double x, double *k) {
    double up = x < 0x1p-1022 ? 54.0 : 0.0, y = x < 0x1p-1022 ? x * 0x1p54 : x;
    uint64_t shifted = bits_of(y) + (0x3ff0000000000000ull - ROOT_HALF);
    *k = (of_bits(0x4330000000000000ull | (shifted >> 52)) - 0x1p52) - (1023.0 + up);
    return of_bits((shifted & MANTISSA) + ROOT_HALF);
}
/* Logarithm at the ends of its domain, beyond them, and y between. */
INLINE double log_ends(double x, double y) {
    y = x == 0.0 ? -INFINITE : y;
    y = x < 0.0 ? NOT_A_NUMBER : y;
    y = x == INFINITE ? x : y;
    return x != x ? x : y;
}
/* log(1 + f) - f for 1 + f from sqrt(1/2) to sqrt(2). */
INLINE double log_rest(double f) {
    double s = f / (2.0 + f), z = s * s, w = z * z, half = 0.5 * f * f;
    double even = w * (LOG_6 * z + LOG_5) + (LOG_4 * z + LOG_3);
    double R = z * (w * (z * even + LOG_2) + (LOG_1 * z + LOG_0));
    return s * (half + R) - half;
}
INLINE double log_of(double x) {
    double k, f = split(x, &k) - 1.0;
    return log_ends(x, k * LN2_0 + (f + (log_rest(f) + k * LN2_1)));
}
INLINE double log1p_of(double x) {
    double u = 1.0 + x, lost = (x - (u - 1.0)) / u;
    double k, f = split(u, &k) - 1.0;
    double y = k * LN2_0 + (f + (log_rest(f) + (k * LN2_1 + lost)));
    return x == 0.0 ? x : x == INFINITE ? x : log_ends(u, y);
}

/* log|x| = its nearest double + rest, with a relative error of about 2^-67. */
INLINE double log_parts(double x, double *rest) {
    double size = size_of(x), k, f = split(size, &k) - 1.0;
    double below = 2.0 + f, below_rest = f - (below - 2.0);
    double s = f / below, lost, p = product(s, below, &lost);
    double s_rest = (((f - p) - lost) - s * below_rest) / below;
    double z_rest, z = product(s, s, &z_rest), w = z * z;
    z_rest = z_rest + 2.0 * s * s_rest;
    /* 2 s + s z (2/3 + z R), with 2/3 as a sum of two. */
    double high = w * LOG_MORE_6 + (LOG_MORE_5 * z + LOG_MORE_4);
    double R = w * (w * high + (LOG_MORE_3 * z + LOG_MORE_2)) + (LOG_MORE_1 * z + LOG_MORE_0);
    double two_thirds = 0x1.5555555555555p-1, q = z * R + 0x1.5555555555555p-55;
    double h = two_thirds + q, h_rest = (two_thirds - h) + q;
    double cube_rest, cube = product(s, z, &cube_rest);
    cube_rest = cube_rest + (s * z_rest + s_rest * z);
    double t_rest, t = product(cube, h, &t_rest);
    t_rest = t_rest + (cube * h_rest + cube_rest * h);
    double twice = 2.0 * s, m = twice + t, m_rest = ((twice - m) + t) + (t_rest + 2.0 * s_rest);
    /* Add k log(2). */
    double kl = k * LN2_0, L = kl + m, back = L - kl;
    double low = ((kl - (L - back)) + (m - back)) + (m_rest + k * LN2_1);
    double sum = L + low;
    *rest = low - (sum - L);
    return log_ends(size, sum);
}

/* From the parts of log|x|; and from those of log(m) for x = 2^k m. */
INLINE double log10_from(double x, double L, double L_rest) {
    double lost, p = product(L, LN10_INVERSE_0, &lost);
    return log_ends(x, p + (lost + (L * LN10_INVERSE_1 + L_rest * LN10_INVERSE_0)));
}
INLINE double log2_from(double x, double k, double L, double L_rest) {
    double lost, p = product(L, LN2_INVERSE_0, &lost);
    return log_ends(x, k + (p + (lost + (L * LN2_INVERSE_1 + L_rest * LN2_INVERSE_0))));
}

/* x^y from the parts of log|x|. */
INLINE double power_of(double x, double y, double L, double L_rest) {
    double size = size_of(x), lost, e = product(L, y, &lost);
    double r = exp_of_sum(e, size_of(e) < 750.0 ? lost + L_rest * y : 0.0, 0.0);
    double up = y > 0.0 ? INFINITE : 0.0, down = y > 0.0 ? 0.0 : INFINITE;
    r = size == 0.0 ? down : r;
    r = size == INFINITE ? up : r;
    double endless = (size > 1.0) == (y > 0.0) ? INFINITE : 0.0;
    r = size_of(y) == INFINITE ? (size == 1.0 ? 1.0 : endless) : r;
    r = x != x ? x : y != y ? y : r;
    /* A negative base has a value for a whole exponent, negative if this is odd. */
    double z = size_of(y), half = 0.5 * z;
    int whole = (z >= 0x1p52) | ((z + 0x1p52) - 0x1p52 == z);
    int odd = (z < 0x1p53) & whole & ((half + 0x1p52) - 0x1p52 != half);
    r = ((x < 0.0) & !whole & (size != INFINITE)) ? NOT_A_NUMBER : r;
    r = odd ? with_sign(r, x) : r;
    return ((y == 0.0) | (x == 1.0)) ? 1.0 : r;
}
/* Parts of log(max(|x|, 1e-100)) from the parts of log|x|. */
INLINE double floor_parts(double L, double L_rest, double *rest) {
    *rest = L < LOG_TINY_0 ? LOG_TINY_1 : L_rest;
    return L < LOG_TINY_0 ? LOG_TINY_0 : L;
}

/* An angle as n pi/2 + r + rest; n is in the last bits of the result. */
INLINE uint64_t quarter_turns(double x, double *r, double *rest) {
    double shifted = x * (2.0 * 0x1.45f306dc9c883p-2) + TO_WHOLE, n = shifted - TO_WHOLE;
    double t = x - n * PI_HALF_SHORT_0, w = n * PI_HALF_SHORT_1, a = t - w;
    double v = n * PI_HALF_SHORT_2 - ((t - a) - w);
    *r = a - v;
    *rest = (a - *r) - v;
    return bits_of(shifted);
}
/* Sine and cosine of n pi/2 + r + rest for |r| <= pi/4. */
INLINE double sine_cosine(uint64_t n, double r, double rest, double *cosine) {
    double z = r * r, w = z * z;
    double ps = w * w * (SIN_5 * z + SIN_4) + (w * (SIN_3 * z + SIN_2) + (SIN_1 * z + SIN_0));
    double pc = w * w * (COS_5 * z + COS_4) + (w * (COS_3 * z + COS_2) + (COS_1 * z + COS_0));
    double s = r + (z * r * ps + rest);
    double half = 0.5 * z, first = 1.0 - half;
    double c = first + (((1.0 - first) - half) + (w * pc - r * rest));
    double sine = (n & 1) ? c : s, other = (n & 1) ? s : c;
    *cosine = of_bits(bits_of(other) ^ (((n + 1) & 2) << 62));
    return of_bits(bits_of(sine) ^ ((n & 2) << 62));
}
INLINE double small_sine_cosine(double x, double *cosine) {
    double r, rest;
    uint64_t n = quarter_turns(x, &r, &rest);
    double sine = sine_cosine(n, r, rest, cosine);
    return x == 0.0 ? x : sine;
}

/* Angle of (run, rise) in the first quarter, both 0 or more. */
INLINE double atan_of_ratio(double rise, double run) {
    const double third = 0x1.a827999fcef32p-2; /* tan(pi/8) */
    int steep = (rise * third > run) | (run == 0.0), middle = rise > run * third;
    double above = steep ? -run : middle ? rise - run : rise;
    double below = steep ? rise : middle ? rise + run : run;
    double top = steep ? PI_HALF_0 : middle ? PI_QUARTER_0 : 0.0;
    double top_rest = steep ? PI_HALF_1 : middle ? PI_QUARTER_1 : 0.0;
    double r = above / below, z = r * r, w = z * z, w2 = w * w;
    double a = w * (ATAN_3 * z + ATAN_2) + (ATAN_1 * z + ATAN_0);
    double b = w * (ATAN_7 * z + ATAN_6) + (ATAN_5 * z + ATAN_4);
    double c = w * ATAN_10 + (ATAN_9 * z + ATAN_8);
    return top + (r + (z * r * (w2 * w2 * c + (w2 * b + a)) + top_rest));
}
INLINE double atan_of(double x) {
    return with_sign(atan_of_ratio(size_of(x), 1.0), x);
}
/* Below, functions in two steps: `inner` is the argument of another function, and `from` has its
   value y. The lengths of the sides of atan2 are scaled, so that their sum is finite. */
INLINE double atan2_scale(double y, double x) {
    int large = (size_of(y) > 0x1p1000) | (size_of(x) > 0x1p1000);
    return large ? 0x1p-10 : 1.0;
}
INLINE double atan2_from(double y, double x, double angle) {
    double rise = size_of(y), run = size_of(x);
    angle = rise == 0.0 ? 0.0 : angle;
    angle = run == INFINITE ? (rise == INFINITE ? PI_QUARTER_0 : 0.0)
        : rise == INFINITE ? PI_HALF_0 : angle;
    angle = bits_of(x) >> 63 ? PI_HALF_0 * 2.0 - (angle - PI_HALF_1 * 2.0) : angle;
    return x != x ? x : y != y ? y : with_sign(angle, y);
}
/* The other side of a triangle with hypotenuse 1. */
INLINE double other_side(double size) { return __builtin_sqrt((1.0 - size) * (1.0 + size)); }
INLINE double asin_from(double x, double y) {
    return size_of(x) <= 1.0 ? with_sign(y, x) : x != x ? x : NOT_A_NUMBER;
}
INLINE double acos_from(double x, double root, double y) {
    y = root == 0.0 ? 0.0 : y;
    y = x < 0.0 ? PI_HALF_0 * 2.0 - (y - PI_HALF_1 * 2.0) : y;
    return size_of(x) <= 1.0 ? y : x != x ? x : NOT_A_NUMBER;
}

/* By expm1. */
INLINE double tanh_inner(double x) {
    double size = size_of(x), up = size > 300.0 ? 600.0 : 2.0 * size;
    return size < 1.0 ? -up : up;
}
INLINE double tanh_from(double x, double y) {
    double size = size_of(x), q = (size < 1.0 ? -y : 2.0) / (y + 2.0);
    return x != x ? x : with_sign(size < 1.0 ? q : 1.0 - q, x);
}
INLINE double sinh_inner(double x) { double size = size_of(x); return size > 30.0 ? 30.0 : size; }
INLINE double sinh_from(double x, double y) {
    return x != x ? x : with_sign(0.5 * (y + y / (y + 1.0)), x);
}
/* e^|x| / 2, which is finite where cosh is. */
INLINE double half_exp(double x) { return exp_of_sum(size_of(x), 0.0, -1.0); }

/* By log1p. */
INLINE double asinh_inner(double x) {
    double size = size_of(x), square = size * size;
    return size + square / (1.0 + __builtin_sqrt(1.0 + square));
}
INLINE double asinh_from(double x, double y) { return x != x ? x : with_sign(y, x); }
INLINE double acosh_inner(double x) {
    double t = x - 1.0;
    return t + __builtin_sqrt(2.0 * t + t * t);
}
INLINE double acosh_from(double x, double y) { return x >= 1.0 ? y : x != x ? x : NOT_A_NUMBER; }
INLINE double atanh_inner(double x) {
    double size = size_of(x), twice = 2.0 * size;
    double small = twice + twice * size / (1.0 - size), large = twice / (1.0 - size);
    return size < 0.5 ? small : large;
}
INLINE double atanh_from(double x, double y) {
    return size_of(x) <= 1.0 ? with_sign(0.5 * y, x) : x != x ? x : NOT_A_NUMBER;
}

INLINE double hypot_of(double x, double y) {
    double a = size_of(x), b = size_of(y), most = a > b ? a : b;
    double scale = most > 0x1p500 ? 0x1p-600 : most < 0x1p-400 ? 0x1p600 : 1.0;
    double back = most > 0x1p500 ? 0x1p600 : most < 0x1p-400 ? 0x1p-600 : 1.0;
    double p = a * scale, q = b * scale;
    double h = __builtin_sqrt(p * p + q * q) * back;
    return ((a == INFINITE) | (b == INFINITE)) ? INFINITE : h;
}

/* NaN if either is NaN, as in NumPy. */
INLINE double least(double a, double b) { return a != a ? a : b < a ? b : b != b ? b : a; }
INLINE double largest(double a, double b) { return a != a ? a : b > a ? b : b != b ? b : a; }
INLINE double sign_of(double x) {
    return x != x ? x : (x > 0.0 ? 1.0 : 0.0) - (x < 0.0 ? 1.0 : 0.0);
}

/* Functions of one number, compiled once; angles may be large. */
double exp_one(double x);
double log_one(double x);
double sine_cosine_one(double x, double *cosine);
#endif
