/* A formula as a tape: a list of operations on registers; each register has a block of rows. */
#ifndef MIHO_TAPE_H
#define MIHO_TAPE_H

#include <stddef.h>
#include <stdint.h>
#include "watch.h"

#define MOST_ROWS 256       /* per block */
#define MANY_REGISTERS 24   /* with more, only half as many rows stay in the cache */
#define MOST_REGISTERS 8192
#define MOST_LENGTH 65536
#define MOST_PARAMETERS 4096 /* of a fit */

/* Name, and numbers of operands and results; miho/core/tape.py defines each. */
#define OPERATIONS(X) \
    X(ADD, 2, 1) X(SUB, 2, 1) X(MUL, 2, 1) X(DIV, 2, 1) \
    X(ADD_S, 2, 1) X(MUL_S, 2, 1) X(SUB_S, 2, 1) X(DIV_S, 2, 1) X(S_SUB, 2, 1) X(S_DIV, 2, 1) \
    X(NEG, 1, 1) X(SQUARE, 1, 1) X(SQRT, 1, 1) X(ABS, 1, 1) X(SIGN, 1, 1) X(COPY, 1, 1) \
    X(MIN, 2, 1) X(MAX, 2, 1) X(BOUND, 1, 1) \
    X(EXP, 1, 1) X(EXPM1, 1, 1) X(LOG, 1, 1) X(LOG1P, 1, 1) X(LOG10, 1, 1) X(LOG2, 1, 1) \
    X(SIN, 1, 1) X(COS, 1, 1) X(SINCOS, 1, 2) X(TAN, 1, 1) \
    X(ASIN, 1, 1) X(ACOS, 1, 1) X(ATAN, 1, 1) X(ATAN2, 2, 1) X(HYPOT, 2, 1) \
    X(SINH, 1, 1) X(COSH, 1, 1) X(TANH, 1, 1) X(ASINH, 1, 1) X(ACOSH, 1, 1) X(ATANH, 1, 1) \
    X(LOG_PARTS, 1, 2) X(FLOOR_PARTS, 2, 2) X(POWER, 4, 1) \
    X(GT, 2, 1) X(GE, 2, 1) X(LT, 2, 1) X(LE, 2, 1) X(EQ, 2, 1) X(NE, 2, 1) \
    X(AND, 2, 1) X(OR, 2, 1) X(NOT, 1, 1) X(WHERE, 3, 1)

#define AS_NAME(name, operands, results) OP_##name,
enum { OPERATIONS(AS_NAME) COUNT_OF_OPERATIONS };
#undef AS_NAME

/* operand[1] of the operations from ADD_S to S_DIV is a scalar; all others are registers. */
typedef struct { int32_t op, operand[4], result[2]; } instruction;

/* Before a loop over rows, which are computed side by side. */
#define EACH_ROW _Pragma("omp simd")

/* The next multiple of eight, and the next address at the beginning of a cache line: vectors across
   two lines are slow. */
static inline int64_t whole(int64_t rows) { return (rows + 7) / 8 * 8; }
static inline double *aligned(void *room) {
    return (double *)(((uintptr_t)room + 63) / 64 * 64);
}

struct level;
struct slopes;

/* Registers are the inputs, the results, then work registers. Scalars are constants, parameters,
   then the results of the first `once` instructions, computed once per call. `fill` has pairs of a
   work register with the same scalar in all rows, and this scalar. */
typedef struct {
    int32_t inputs, results, registers, constants, parameters, scalars, once, length, fills;
    const instruction *code; /* once + length */
    const double *constant;
    const int32_t *fill;
    const struct level *level;
} tape;

/* The operations, compiled for one kind of processor. */
typedef struct level {
    const char *name;
    /* Registers have room for whole(rows) numbers, or for a single row. */
    void (*run)(const instruction *from, const instruction *to, double *const *registers,
                const double *scalars, int rows);
    double (*square_sum)(const double *values, const double *data, int rows);
    double (*product_sum)(const double *a, const double *b, int64_t rows);
    void (*fold)(double *T, int64_t side, double *columns, int64_t stride, int64_t rows, int64_t n,
                 watch *by);
    void (*update_columns)(double *columns, const double *residuals, const double *step,
                           const double *D, double total, int64_t d, int64_t m);
    void (*vary)(const struct slopes *of, const double *values, const double *x, double *direct,
                 double *out);
    void (*vary_step)(const struct slopes *of, const double *values, double h, double *x,
                      double *work);
} level;
extern const level level_baseline, level_avx2, level_avx512;
/* `run` of all levels for one row. */
void run_one_row(const instruction *from, const instruction *to, double *const *registers,
                 const double *scalars);
/* Highest level of this processor. */
const level *highest_level(void);

/* Results of parameter rows thetas (n, d) at X (p, N): out (n, results, N). */
int tape_evaluate(const tape *t, const double *thetas, int64_t n, const double *X, int64_t N,
                  double *out);
/* Columns X (p, N), and y (rows,) for their first rows. The first block has `first` rows. */
typedef struct { const double *X; int64_t N; const double *y; int64_t rows, first; } measurements;

/* Mean squares (n,) of the single result minus y. */
int tape_mean_squares(const tape *t, const double *thetas, int64_t n, const measurements *d,
                      double *out);
/* The single result minus y at rows i to j of X (p, N), out (j - i,). */
void tape_residuals(const tape *t, const double *theta, const double *X, int64_t N,
                    const double *y, int64_t i, int64_t j, double *out);
/* All results at these rows, at intervals of `stride` numbers, all of which may be written. */
void tape_columns(const tape *t, const double *theta, const double *X, int64_t N, int64_t i,
                  int64_t j, double *out, int64_t stride);

/* Room for many calls, in blocks of at most this number of rows, NULL without memory. */
typedef struct workspace workspace;
workspace *tape_open(const tape *t, int64_t rows);
void tape_close(workspace *w);
/* As `tape_columns` at rows i to j, after `tape_start` at a configuration. */
void tape_start(const tape *t, const double *theta, workspace *w);
void tape_continue(const tape *t, const double *X, int64_t N, int64_t i, int64_t j, double *out,
                   int64_t stride, workspace *w);
/* One mean square, or any number from `limit` on as soon as it is known to reach it. */
double tape_mean_square(const tape *t, const double *theta, const measurements *d, double limit,
                        workspace *w);
#endif
