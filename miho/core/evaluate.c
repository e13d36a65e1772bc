/* Tapes on rows of data, block by block; each call allocates its work arrays once. */
#include <stdlib.h>
#include <string.h>
#include "tape.h"

struct workspace {
    double **registers;     /* rows of each */
    double **each_scalar;
    double *scalars;
    double *work;           /* work registers, and room for one more */
    int rows;               /* per block */
};

static int rows_of_block(const tape *t) {
    return t->registers - t->inputs > MANY_REGISTERS ? MOST_ROWS / 2 : MOST_ROWS;
}

/* Fill registers with scalars: with the constants, or with values that depend on parameters. */
static void fill(const tape *t, int constants, workspace *w) {
    for (int k = 0; k < t->fills; k++) {
        int32_t from = t->fill[2 * k + 1];
        double *o = w->registers[t->fill[2 * k]];
        if ((from < t->constants) == constants)
            for (int i = 0; i < w->rows; i++) o[i] = w->scalars[from];
    }
}

/* Room for blocks of this number of rows, false without memory. Only `workspace.registers` has to
   be freed. */
static int allocate_rows(const tape *t, int rows, workspace *w) {
    size_t pointers = (size_t)t->registers + t->scalars;
    size_t of_work = t->registers - t->inputs - t->results + 1;
    w->rows = (int)whole(rows);
    size_t before = pointers * sizeof(double *) + t->scalars * sizeof(double) + 64;
    w->registers = malloc(before + of_work * w->rows * sizeof(double));
    if (!w->registers) return 0;
    w->each_scalar = w->registers + t->registers;
    w->scalars = (double *)(w->each_scalar + t->scalars);
    w->work = aligned(w->scalars + t->scalars);
    for (int k = 0; k < t->scalars; k++) w->each_scalar[k] = w->scalars + k;
    for (int k = t->inputs + t->results; k < t->registers; k++)
        w->registers[k] = w->work + (size_t)(k - t->inputs - t->results + 1) * w->rows;
    memcpy(w->scalars, t->constant, t->constants * sizeof(double));
    fill(t, 1, w);
    return 1;
}

static int allocate(const tape *t, workspace *w) { return allocate_rows(t, rows_of_block(t), w); }

/* Compute values that depend on the parameters alone. */
static void start(const tape *t, const double *theta, workspace *w) {
    memcpy(w->scalars + t->constants, theta, t->parameters * sizeof(double));
    t->level->run(t->code, t->code + t->once, w->each_scalar, w->scalars, 1);
    fill(t, 0, w);
}

/* All results of rows i to i + rows, at most a block, at intervals of `stride` numbers. */
static void block(const tape *t, const double *X, int64_t N, int64_t i, int rows, double *out,
                  int64_t stride, workspace *w) {
    const instruction *code = t->code + t->once;
    for (int k = 0; k < t->inputs; k++) w->registers[k] = (double *)X + k * N + i;
    for (int k = 0; k < t->results; k++) w->registers[t->inputs + k] = out + k * stride;
    t->level->run(code, code + t->length, w->registers, w->scalars, rows);
}

static int fewer(int64_t left, int most) { return left < most ? (int)left : most; }

static void columns(const tape *t, const double *X, int64_t N, int64_t i, int64_t j, double *out,
                    int64_t stride, workspace *w) {
    for (int64_t k = i; k < j; k += w->rows)
        block(t, X, N, k, fewer(j - k, w->rows), out + (k - i), stride, w);
}

static void not_a_number(double *out, int64_t n) {
    for (int64_t k = 0; k < n; k++) out[k] = __builtin_nan("");
}

int tape_evaluate(const tape *t, const double *thetas, int64_t n, const double *X, int64_t N,
                  double *out) {
    workspace w;
    if (!allocate(t, &w)) return 0;
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
        block(t, d->X, d->N, i, m, w->work, 0, w);
        total += t->level->square_sum(w->work, d->y + i, m);
        if (total / (double)d->rows >= limit) break;
        size = fewer(2 * size, w->rows);
    }
    return total / (double)d->rows;
}

int tape_mean_squares(const tape *t, const double *thetas, int64_t n, const measurements *d,
                      double *out) {
    workspace w;
    if (!allocate(t, &w)) return 0;
    for (int64_t k = 0; k < n; k++)
        out[k] = tape_mean_square(t, thetas + k * t->parameters, d, __builtin_inf(), &w);
    free(w.registers);
    return 1;
}

void tape_residuals(const tape *t, const double *theta, const double *X, int64_t N,
                    const double *y, int64_t i, int64_t j, double *out) {
    tape_columns(t, theta, X, N, i, j, out, 0);
    for (int64_t k = i; k < j; k++) out[k - i] -= y[k];
}

void tape_columns(const tape *t, const double *theta, const double *X, int64_t N, int64_t i,
                  int64_t j, double *out, int64_t stride) {
    workspace w;
    /* Few rows: registers side by side share the first-level cache. Without memory the residuals are
       not finite, which ends a descent. */
    if (!allocate_rows(t, fewer(j - i, rows_of_block(t)), &w)) {
        for (int k = 0; k < t->results; k++) not_a_number(out + k * stride, j - i);
        return;
    }
    start(t, theta, &w);
    columns(t, X, N, i, j, out, stride, &w);
    free(w.registers);
}

workspace *tape_open(const tape *t, int64_t rows) {
    workspace *w = malloc(sizeof *w);
    if (w && allocate_rows(t, fewer(rows, rows_of_block(t)), w)) return w;
    free(w);
    return NULL;
}

void tape_close(workspace *w) {
    if (w) free(w->registers);
    free(w);
}

void tape_start(const tape *t, const double *theta, workspace *w) { start(t, theta, w); }

void tape_continue(const tape *t, const double *X, int64_t N, int64_t rows, double *out,
                   int64_t stride, workspace *w) {
    columns(t, X, N, 0, rows, out, stride, w);
}
