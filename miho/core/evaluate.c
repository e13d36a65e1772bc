/* Tapes on rows of data, block by block; each call allocates its work arrays once. */
#include <stdlib.h>
#include <string.h>
#include "tape.h"

struct workspace {
    double **registers;     /* rows of each */
    double **each_scalar;
    double *scalars;
    double *work;           /* work registers, and room for one more */
    double *copies;         /* inputs and results of a block that is not whole registers */
    int rows, copied;       /* per block; per copy */
};

static int fewer(int64_t left, int most) { return left < most ? (int)left : most; }

static int rows_of_block(const tape *t) {
    return t->registers - t->inputs > MANY_REGISTERS ? MOST_ROWS / 2 : MOST_ROWS;
}

/* Rows of the last block of n, 0 if it is whole registers, and needs no copies. */
static int last_rows(const tape *t, int64_t n) { return n % 8 ? (int)(n % rows_of_block(t)) : 0; }

static double *copy_of(const workspace *w, int k) { return w->copies + (size_t)k * w->copied; }

/* Fill registers with scalars: with the constants, or with values that depend on parameters. */
static void fill(const tape *t, int constants, workspace *w) {
    for (int k = 0; k < t->fills; k++) {
        int32_t from = t->fill[2 * k + 1];
        double *o = w->registers[t->fill[2 * k]], value = w->scalars[from];
        if ((from < t->constants) == constants)
            EACH_ROW for (int i = 0; i < w->rows; i++) o[i] = value;
    }
}

/* Room for blocks of at most this number of rows, and for copies, false without memory. With few
   rows, registers side by side share the first-level cache. Only `workspace.registers` has to be
   freed. */
static int allocate(const tape *t, int64_t rows, int64_t copied, workspace *w) {
    int first = t->inputs + t->results;
    size_t pointers = (size_t)t->registers + t->scalars;
    w->rows = (int)whole(fewer(rows, rows_of_block(t)));
    w->copied = (int)whole(fewer(copied, w->rows));
    size_t of_work = ((size_t)t->registers - first + 1) * w->rows;
    size_t numbers = t->scalars + of_work + (size_t)first * w->copied;
    w->registers = malloc(pointers * sizeof(double *) + numbers * sizeof(double) + 64);
    if (!w->registers) return 0;
    w->each_scalar = w->registers + t->registers;
    w->scalars = (double *)(w->each_scalar + t->scalars);
    w->work = aligned(w->scalars + t->scalars);
    for (int k = 0; k < t->scalars; k++) w->each_scalar[k] = w->scalars + k;
    w->copies = w->work + of_work;
    for (int k = first; k < t->registers; k++)
        w->registers[k] = w->work + (size_t)(k - first + 1) * w->rows;
    memcpy(w->scalars, t->constant, t->constants * sizeof(double));
    fill(t, 1, w);
    return 1;
}

/* Compute values that depend on the parameters alone. */
static void start(const tape *t, const double *theta, workspace *w) {
    memcpy(w->scalars + t->constants, theta, t->parameters * sizeof(double));
    t->level->run(t->code, t->code + t->once, w->each_scalar, w->scalars, 1);
    fill(t, 0, w);
}

/* Inputs at rows i to i + rows. Whole registers are read; only near the end of X (p, N) are there
   too few numbers, and the last row is repeated in a copy. */
static void set_inputs(const tape *t, const double *X, int64_t N, int64_t i, int rows,
                       workspace *w) {
    for (int k = 0; k < t->inputs; k++) {
        const double *column = X + k * N + i;
        w->registers[k] = (double *)column;
        if ((t->inputs - k) * N - i >= whole(rows)) continue;
        double *copy = w->registers[k] = copy_of(w, k);
        memcpy(copy, column, rows * sizeof(double));
        for (int64_t j = rows; j < whole(rows); j++) copy[j] = column[rows - 1];
    }
}

/* All results of rows i to i + rows, at most a block, at intervals of `stride` numbers, `left` of
   which may be written. */
static void block(const tape *t, int rows, double *out, int64_t stride, int64_t left,
                  workspace *w) {
    const instruction *code = t->code + t->once;
    int direct = rows % 8 == 0 || whole(rows) <= left, first = t->inputs;
    for (int k = 0; k < t->results; k++)
        w->registers[first + k] = direct ? out + k * stride : copy_of(w, first + k);
    t->level->run(code, code + t->length, w->registers, w->scalars, rows);
    for (int k = 0; k < t->results && !direct; k++)
        memcpy(out + k * stride, copy_of(w, first + k), rows * sizeof(double));
}

static void columns(const tape *t, const double *X, int64_t N, int64_t i, int64_t j, double *out,
                    int64_t stride, workspace *w) {
    for (int64_t k = i; k < j; k += w->rows) {
        int rows = fewer(j - k, w->rows);
        set_inputs(t, X, N, k, rows, w);
        block(t, rows, out + (k - i), stride, stride - (k - i), w);
    }
}

static void not_a_number(double *out, int64_t n) {
    for (int64_t k = 0; k < n; k++) out[k] = __builtin_nan("");
}

int tape_evaluate(const tape *t, const double *thetas, int64_t n, const double *X, int64_t N,
                  double *out) {
    workspace w;
    if (!allocate(t, N, last_rows(t, N), &w)) return 0;
    for (int64_t k = 0; k < n; k++) {
        start(t, thetas + k * t->parameters, &w);
        columns(t, X, N, 0, N, out + k * t->results * N, N, &w);
    }
    free(w.registers);
    return 1;
}

double tape_mean_square(const tape *t, const double *theta, const measurements *d, double limit,
                        workspace *w) {
    double total = 0.0;
    int size = fewer(d->first, w->rows), m;
    start(t, theta, w);
    for (int64_t i = 0; i < d->rows; i += m) {
        m = fewer(d->rows - i, size);
        set_inputs(t, d->X, d->N, i, m, w);
        block(t, m, w->work, 0, w->rows, w);
        total += t->level->square_sum(w->work, d->y + i, m);
        if (total / (double)d->rows >= limit) break;
        size = fewer(2 * size, w->rows);
    }
    return total / (double)d->rows;
}

int tape_mean_squares(const tape *t, const double *thetas, int64_t n, const measurements *d,
                      double *out) {
    workspace w;
    if (!allocate(t, d->rows, d->rows, &w)) return 0;
    for (int64_t k = 0; k < n; k++)
        out[k] = tape_mean_square(t, thetas + k * t->parameters, d, __builtin_inf(), &w);
    free(w.registers);
    return 1;
}

void tape_residuals(const tape *t, const double *theta, const double *X, int64_t N,
                    const double *y, int64_t i, int64_t j, double *out) {
    tape_columns(t, theta, X, N, i, j, out, j - i);
    EACH_ROW for (int64_t k = i; k < j; k++) out[k - i] -= y[k];
}

void tape_columns(const tape *t, const double *theta, const double *X, int64_t N, int64_t i,
                  int64_t j, double *out, int64_t stride) {
    workspace w;
    /* Without memory the residuals are not finite, which ends a descent. */
    if (!allocate(t, j - i, last_rows(t, j - i), &w)) {
        for (int k = 0; k < t->results; k++) not_a_number(out + k * stride, j - i);
        return;
    }
    start(t, theta, &w);
    columns(t, X, N, i, j, out, stride, &w);
    free(w.registers);
}

workspace *tape_open(const tape *t, int64_t rows) {
    workspace *w = malloc(sizeof *w);
    if (w && allocate(t, rows, rows, w)) return w;
    free(w);
    return NULL;
}

void tape_close(workspace *w) {
    if (w) free(w->registers);
    free(w);
}

void tape_start(const tape *t, const double *theta, workspace *w) { start(t, theta, w); }

void tape_continue(const tape *t, const double *X, int64_t N, int64_t i, int64_t j, double *out,
                   int64_t stride, workspace *w) {
    columns(t, X, N, i, j, out, stride, w);
}
