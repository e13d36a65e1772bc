/* Trajectories and their sensitivities by the classical Runge-Kutta method, on tapes.

   Values are computed for several parameter rows side by side, sensitivities for one row: first its
   states, some steps ahead; then the derivatives of the rates at all stages of these steps side by
   side; then the sensitivities, by equations that are linear in them. Each stage is differentiated,
   so that these are the derivatives of the computed values, up to rounding. */
#include <stdlib.h>
#include <string.h>
#include "trajectory.h"

#define LANES 64            /* parameter rows side by side */
#define MOST_EVENTS MOST_POINTS

/* A tape with fixed addresses of inputs and results. */
typedef struct {
    const tape *t;
    double **registers, **each_scalar, *scalars;
    int rows;
} function;

/* Motion of some rows: states x, states of a stage, states after the step, and their rates (S,
   rows); outputs (K, rows), parameters (d, rows), inputs (q,). */
typedef struct {
    function rates, outputs;
    double *x, *at, *after, *dx, *y, *p, *u;
    int rows;
} values;

/* Events along a course, in order. */
typedef struct visitor {
    void (*begin)(struct visitor *, int64_t m);
    void (*step)(struct visitor *, int64_t j, int64_t substep);
    void (*observe)(struct visitor *, int64_t j);
} visitor;

/* Allocate doubles, then pointers, in one piece; 0 without memory. */
static int take_function(const tape *t, int rows, function *f) {
    size_t of_work = (size_t)(t->registers - t->inputs - t->results) * rows;
    size_t numbers = of_work + t->scalars, pointers = (size_t)t->registers + t->scalars;
    double *work = malloc(numbers * sizeof(double) + pointers * sizeof(double *));
    f->t = t;
    f->scalars = work;
    f->rows = rows;
    if (!work) return 0;
    f->registers = (double **)(work + numbers);
    f->each_scalar = f->registers + t->registers;
    for (int k = 0; k < t->scalars; k++) f->each_scalar[k] = work + k;
    for (int k = t->inputs + t->results, i = 0; k < t->registers; k++, i++)
        f->registers[k] = work + t->scalars + (size_t)i * rows;
    memcpy(f->scalars, t->constant, t->constants * sizeof(double));
    return 1;
}

static void place(function *f, int first, int count, double *at) {
    for (int k = 0; k < count; k++) f->registers[first + k] = at + (size_t)k * f->rows;
}

static void call(function *f, double now, const double *u) {
    const tape *t = f->t;
    f->scalars[t->constants] = now;
    for (int k = 1; k < t->parameters; k++) f->scalars[t->constants + k] = u[k - 1];
    t->level->run(t->code, t->code + t->once, f->each_scalar, f->scalars, 1);
    for (int k = 0; k < t->fills; k++) {
        double *o = f->registers[t->fill[2 * k]], value = f->scalars[t->fill[2 * k + 1]];
        EACH_ROW for (int i = 0; i < f->rows; i++) o[i] = value;
    }
    t->level->run(t->code + t->once, t->code + t->once + t->length, f->registers, f->scalars,
                  f->rows);
}

static void drop_values(values *v) {
    free(v->rates.scalars);
    free(v->outputs.scalars);
    free(v->x);
}

static int take_values(const motion *m, const course *c, int rows, values *v) {
    int64_t S = c->S, numbers = (4 * S + c->K + c->d) * rows + c->q;
    memset(v, 0, sizeof *v);
    v->rows = rows;
    v->x = calloc(numbers, sizeof(double));
    if (!v->x || !take_function(m->rates, rows, &v->rates) ||
        !take_function(m->outputs, rows, &v->outputs)) return 0;
    v->at = v->x + S * rows;
    v->after = v->at + S * rows;
    v->dx = v->after + S * rows;
    v->y = v->dx + S * rows;
    v->p = v->y + c->K * rows;
    v->u = v->p + c->d * rows;
    place(&v->rates, 0, S, v->at);
    place(&v->rates, S, c->d, v->p);
    place(&v->rates, S + c->d, S, v->dx);
    place(&v->outputs, 0, S, v->x);
    place(&v->outputs, S, c->d, v->p);
    place(&v->outputs, S + c->d, c->K, v->y);
    return 1;
}

static void begin_values(values *v, const course *c, int64_t m) {
    for (int64_t s = 0; s < c->S; s++) {
        int64_t k = c->parameters[m * c->S + s];
        for (int i = 0; i < v->rows; i++)
            v->x[s * v->rows + i] = k < 0 ? c->values[m * c->S + s] : v->p[k * v->rows + i];
    }
}

/* Inputs at a share of the way from row j to row j + 1. */
static void inputs_at(const course *c, int64_t j, double share, double *u) {
    const double *row = c->u + j * c->q;
    for (int64_t k = 0; k < c->q; k++)
        u[k] = share > 0 && !c->held ? row[k] + share * (row[c->q + k] - row[k]) : row[k];
}

/* t, u and x of the one row, as inputs of derivatives. */
static void note(const values *v, const course *c, double now, const double *x, double *point) {
    point[0] = now;
    for (int64_t k = 0; k < c->q; k++) point[(1 + k) * APART] = v->u[k];
    for (int64_t s = 0; s < c->S; s++) point[(1 + c->q + s) * APART] = x[s];
}

static double step_of(const course *c, int64_t j) {
    return (c->t[j + 1] - c->t[j]) / (double)c->substeps;
}

/* A step of x. Its four stages are written to `points`, unless it is NULL. */
static void advance(values *v, const course *c, int64_t j, int64_t substep, double *points) {
    int64_t size = c->S * v->rows;
    double h = step_of(c, j), now = 0.0;
    memcpy(v->at, v->x, size * sizeof(double));
    memcpy(v->after, v->x, size * sizeof(double));
    for (int stage = 0; stage < 4; stage++) { /* at 0, 1/2, 1/2 and 1 of the step */
        double ahead = (stage + 1) / 2 / 2.0, weight = stage == 1 || stage == 2 ? h / 3 : h / 6;
        if (stage)
            EACH_ROW for (int64_t i = 0; i < size; i++) v->at[i] = v->x[i] + ahead * h * v->dx[i];
        if (stage != 2) {
            inputs_at(c, j, ((double)substep + ahead) / (double)c->substeps, v->u);
            now = c->t[j] + ((double)substep + ahead) * h;
        }
        if (points) note(v, c, now, v->at, points + stage);
        call(&v->rates, now, v->u);
        EACH_ROW for (int64_t i = 0; i < size; i++) v->after[i] += weight * v->dx[i];
    }
    memcpy(v->x, v->after, size * sizeof(double));
}

/* Segments begin before their first row is observed. A restart follows the row, which is still
   predicted. */
static void follow(const course *c, visitor *v) {
    for (int64_t j = 0; j < c->N; j++) {
        for (int64_t substep = 0; j && substep < c->substeps; substep++)
            v->step(v, j - 1, substep);
        int64_t m = c->reset[j];
        if (m >= 0 && (!j || !c->restart)) v->begin(v, m);
        v->observe(v, j);
        if (m >= 0 && j && c->restart) v->begin(v, m);
    }
}

/* Values of some parameter rows, into out (rows, R). Further rows fill the last registers. */
typedef struct {
    visitor is;
    const course *c;
    values now;
    int rows;
    double *out;
} simulation;

static void begin_simulation(visitor *is, int64_t m) {
    simulation *s = (simulation *)is;
    begin_values(&s->now, s->c, m);
}
static void step_simulation(visitor *is, int64_t j, int64_t substep) {
    simulation *s = (simulation *)is;
    advance(&s->now, s->c, j, substep, NULL);
}
static void observe_simulation(visitor *is, int64_t j) {
    simulation *s = (simulation *)is;
    const course *c = s->c;
    inputs_at(c, j, 0.0, s->now.u);
    call(&s->now.outputs, c->t[j], s->now.u);
    for (int64_t r = c->first[j]; r < c->first[j + 1]; r++) {
        int64_t row = c->rows[r];
        const double *y = s->now.y + c->output[row] * s->now.rows;
        for (int i = 0; i < s->rows; i++) s->out[i * c->R + row] = y[i];
    }
}

int trajectory_solve(const motion *m, const course *c, const double *thetas, int64_t n,
                     double *out) {
    for (int64_t block = 0; block < n; block += LANES) {
        int rows = n - block < LANES ? (int)(n - block) : LANES;
        simulation s = {.is = {begin_simulation, step_simulation, observe_simulation}, .c = c,
                        .rows = rows, .out = out + block * c->R};
        int all = rows == 1 ? 1 : (int)whole(rows), done = take_values(m, c, all, &s.now);
        for (int64_t k = 0; done && k < c->d; k++)
            for (int i = 0; i < all; i++)
                s.now.p[k * all + i] = thetas[(block + (i < rows ? i : 0)) * c->d + k];
        if (done) follow(c, &s.is);
        drop_values(&s.now);
        if (!done) return 0;
    }
    return 1;
}

/* Sensitivities. Events are collected, and the points of their derivatives are stored. */
enum { BEGIN, STEP, OBSERVE };
typedef struct { int kind; int64_t at; } event;
typedef struct {
    visitor is;
    const course *c;
    const slopes *of;           /* of the rates and of the outputs */
    const double *theta;
    values now;
    double *points[2];          /* (1 + q + S, APART): stages, and observed rows */
    double *derivatives[2];     /* (count, APART) */
    double *x, *work;           /* (S, width), and work for a step */
    double *direct, *y;         /* (K, width) */
    int used[2];
    event events[MOST_EVENTS];
    int waiting;
    double *out;
} variation;

static void begin_variation(const variation *v, int64_t m) {
    int64_t width = v->of->width;
    for (int64_t s = 0; s < v->c->S; s++)
        for (int64_t k = 0; k < width; k++)
            v->x[s * width + k] = k == v->c->parameters[m * v->c->S + s] ? 1.0 : 0.0;
}

static void observe_variation(const variation *v, int64_t j, const double *derivatives) {
    const course *c = v->c;
    v->of[1].tape->level->vary(&v->of[1], derivatives, v->x, v->direct, v->y);
    for (int64_t r = c->first[j]; r < c->first[j + 1]; r++) {
        int64_t row = c->rows[r];
        memcpy(v->out + row * c->d, v->y + c->output[row] * v->of->width, c->d * sizeof(double));
    }
}

/* Advance the sensitivities as far as the states. Without memory for the tapes they are NaN. */
static void catch_up(variation *v) {
    int done[2] = {0};
    for (int k = 0; k < 2; k++)
        tape_columns(v->of[k].tape, v->theta, v->points[k], APART, 0, v->used[k],
                     v->derivatives[k], APART);
    for (const event *e = v->events; e < v->events + v->waiting; e++) {
        if (e->kind == BEGIN) begin_variation(v, e->at);
        else if (e->kind == OBSERVE) observe_variation(v, e->at, v->derivatives[1] + done[1]++);
        else {
            v->of->tape->level->vary_step(v->of, v->derivatives[0] + done[0], step_of(v->c, e->at),
                                          v->x, v->work);
            done[0] += 4;
        }
    }
    v->waiting = v->used[0] = v->used[1] = 0;
}

static void schedule(variation *v, int kind, int64_t at) {
    v->events[v->waiting++] = (event){kind, at};
    if (v->waiting == MOST_EVENTS || v->used[0] == MOST_POINTS || v->used[1] == MOST_POINTS)
        catch_up(v);
}

static void note_begin(visitor *is, int64_t m) {
    variation *v = (variation *)is;
    begin_values(&v->now, v->c, m);
    schedule(v, BEGIN, m);
}
static void note_step(visitor *is, int64_t j, int64_t substep) {
    variation *v = (variation *)is;
    advance(&v->now, v->c, j, substep, v->points[0] + v->used[0]);
    v->used[0] += 4;
    schedule(v, STEP, j);
}
static void note_row(visitor *is, int64_t j) {
    variation *v = (variation *)is;
    inputs_at(v->c, j, 0.0, v->now.u);
    note(&v->now, v->c, v->c->t[j], v->now.x, v->points[1] + v->used[1]++);
    schedule(v, OBSERVE, j);
}

/* 0 without memory; besides the values, only `points[0]` has to be freed. */
static int take_variation(const motion *m, variation *v) {
    const course *c = v->c;
    int64_t width = v->of->width, inputs = 1 + c->q + c->S;
    int64_t points = (2 * inputs + v->of[0].count + v->of[1].count) * APART;
    double *room = calloc(points + (8 * c->S + 2 * c->K) * width, sizeof(double));
    v->points[0] = room;
    if (!take_values(m, c, 1, &v->now) || !room) return 0;
    v->points[1] = room + inputs * APART;
    v->derivatives[0] = v->points[1] + inputs * APART;
    v->derivatives[1] = v->derivatives[0] + v->of[0].count * APART;
    v->x = room + points;
    v->work = v->x + c->S * width;
    v->direct = v->work + 7 * c->S * width;
    v->y = v->direct + c->K * width;
    memcpy(v->now.p, v->theta, c->d * sizeof(double));
    return 1;
}

int trajectory_derive(const motion *m, const slopes of[2], const course *c, const double *theta,
                      double *out) {
    variation v = {.is = {note_begin, note_step, note_row}, .c = c, .of = of, .theta = theta,
                   .out = out};
    int done = take_variation(m, &v);
    if (done) {
        follow(c, &v.is);
        catch_up(&v);
    }
    drop_values(&v.now);
    free(v.points[0]);
    return done;
}
