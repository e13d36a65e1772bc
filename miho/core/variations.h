/* Derivatives with respect to parameters, along the states. Compiled once for each level. */
#include "trajectory.h"

#define DERIVATIVE(i) values[(i) * APART] /* at one point */
/* In one register, or few: writing number by number is slower. */
typedef double eight __attribute__((vector_size(64), aligned(8), may_alias));

/* direct (rows, width): direct derivatives with respect to parameters. Zeros stay. */
static void set_direct(const slopes *of, const double *values, double *direct) {
    for (int64_t i = of->chained; i < of->count; i++) {
        int64_t row = of->at[2 * i], column = of->at[2 * i + 1] - of->states;
        direct[row * of->width + column] = DERIVATIVE(i);
    }
}

/* out (rows, width): derivatives by the chain rule, from derivatives of the states x (S, width). */
static void chain(const slopes *of, const double *values, const double *x, const double *direct,
                  double *out) {
    int64_t width = of->width, from = 0, to = 0;
    for (int64_t row = 0; row < of->rows; row++, from = to) {
        while (to < of->chained && of->at[2 * to] == row) to++;
        for (int64_t k = 0; k < width; k += 8) {
            eight sums = {0};
            for (int64_t i = from; i < to; i++)
                sums += DERIVATIVE(i) * *(const eight *)(x + of->at[2 * i + 1] * width + k);
            *(eight *)(out + row * width + k) = sums + *(const eight *)(direct + row * width + k);
        }
    }
}

static void vary(const slopes *of, const double *values, const double *x, double *direct,
                 double *out) {
    set_direct(of, values, direct);
    chain(of, values, x, direct, out);
}

/* A step of length h of x (S, width), from derivatives at its four stages. work (7 S, width): zeros
   at first, then as the previous step left it. */
static void vary_step(const slopes *of, const double *values, double h, double *x, double *work) {
    int64_t size = of->rows * of->width;
    double *at = work, *after = at + size, *dx = after + size, *direct = dx + size;
    /* Write all before any is read: reading back numbers just written is slow. */
    for (int stage = 0; stage < 4; stage++) set_direct(of, values + stage, direct + stage * size);
    for (int64_t k = 0; k < size; k++) at[k] = after[k] = x[k];
    for (int stage = 0; stage < 4; stage++) {
        double ahead = (stage + 1) / 2 / 2.0 * h, weight = stage == 1 || stage == 2 ? h / 3 : h / 6;
        if (stage)
            EACH_ROW for (int64_t k = 0; k < size; k++) at[k] = x[k] + ahead * dx[k];
        chain(of, values + stage, at, direct + stage * size, dx);
        EACH_ROW for (int64_t k = 0; k < size; k++) after[k] += weight * dx[k];
    }
    memcpy(x, after, size * sizeof(double));
}
