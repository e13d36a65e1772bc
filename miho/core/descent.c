/* Descent of one candidate: its evaluations, one after the other, and the steps between them.
   Derivatives are folded into triangular factors chunk by chunk, so that memory does not grow with
   the number of rows. Python form: tests/core/python_bracket.py. */
#include <math.h>
#include <string.h>
#include "elementary.h"
#include "search.h"

/* Configuration at unit coordinates x, in units. */
static void to_units(const problem *p, const double *x, double *theta) {
    for (int64_t k = 0; k < p->d; k++) {
        double value = p->origin[k] + p->width[k] * x[k];
        if (p->log[k]) value = exp_one(value);
        theta[k] = between(p->low[k], value, p->high[k]);
    }
}

/* Move a trial to its best linear parameters, and return the loss there, by algebra. w.T is the
   triangular factor of their columns, in box widths, and of the residuals at w.theta. The loss is
   infinite if it is not finite. */
static double solve_linear(search *s, candidate *c) {
    const problem *p = &s->p;
    const work_room *w = &s->w;
    int64_t n = p->linears, side = p->d + 1;
    for (int64_t j = 0; j <= n; j++)
        for (int64_t k = j; k <= n; k++)
            if (!isfinite(w->T[j * side + k])) return INFINITY;
    for (int64_t j = 0; j < n; j++) {
        int64_t k = p->linear[j];
        double width = p->high[k] - p->low[k];
        w->scale[j] = 0.0;
        w->low[j] = (p->low[k] - w->theta[k]) / width;
        w->high[j] = (p->high[k] - w->theta[k]) / width;
    }
    box_problem b = {w->T, w->T + n, w->scale, w->low, w->high, side, side, n};
    solve_in_box(&b, w->step, &w->solver);
    if (is_stopped(s)) return 0.0;
    double rest = w->T[n * side + n], square = rest * rest + square_norm(&b, w->step);
    for (int64_t j = 0; j < n; j++) {
        int64_t k = p->linear[j];
        double value = w->theta[k] + (p->high[k] - p->low[k]) * w->step[j];
        value = between(p->low[k], value, p->high[k]);
        if (p->log[k]) value = log_one(value);
        c->trial[k] = between(0.0, (value - p->origin[k]) / p->width[k], 1.0);
    }
    return square / (double)s->m;
}

/* Sum of squares at w.theta over the rows of this level; w.sums takes the sums over the rows of
   each level, and w.residuals the residuals to `keep`. */
static double look(search *s, int keep) {
    const problem *p = &s->p;
    double total = 0.0;
    int64_t start = 0;
    for (int64_t level = 0; level < p->levels; level++) {
        int64_t end = p->level_rows[level] < s->m ? p->level_rows[level] : s->m;
        while (start < end) {
            int64_t rows = end - start < CHUNK ? end - start : CHUNK;
            double *r = s->w.residuals + (keep ? start : 0);
            p->residuals(p->value_tape, s->w.theta, p->X, p->N, p->y, start, start + rows, r);
            total += p->sums->product_sum(r, r, rows);
            start += rows;
        }
        s->w.sums[level] = total;
    }
    return total;
}

static int is_linear(const problem *p, int64_t k) {
    for (int64_t j = 0; j < p->linears; j++)
        if (p->linear[j] == k) return 1;
    return 0;
}

/* Convert derivatives in units to a coordinate with this width. */
static void scale_column(const double *slopes, double width, int64_t rows, double *scaled) {
    EACH_ROW for (int64_t i = 0; i < rows; i++) scaled[i] = slopes[i] * width;
}

/* Scale the columns in w.slopes into w.chunk, in the order of `take_factor`, or the linear ones
   only; returns their number. */
static int64_t order_columns(const search *s, const candidate *c, int only_linear, int64_t rows) {
    const problem *p = &s->p;
    const work_room *w = &s->w;
    int64_t n = 0;
    for (int64_t j = 0; (only_linear || c->has->projects) && j < p->linears; j++) {
        int64_t k = p->linear[j];
        if (only_linear || is_free(c->x[k]))
            scale_column(w->slopes + k * CHUNK, p->high[k] - p->low[k], rows,
                         w->chunk + CHUNK * n++);
    }
    for (int64_t k = 0; !only_linear && k < p->d; k++) {
        if (c->has->projects && is_linear(p, k)) continue;
        double width = p->width[k] * (p->log[k] ? w->theta[k] : 1.0);
        scale_column(w->slopes + k * CHUNK, width, rows, w->chunk + CHUNK * n++);
    }
    return n;
}

/* Write the triangular factor of derivatives and residuals at w.theta to w.T, chunk by chunk: of
   the linear parameters only, in box widths, or in the order of `take_factor`. */
static void fill(search *s, candidate *c, int only_linear) {
    const problem *p = &s->p;
    const work_room *w = &s->w;
    int64_t d = p->d, m = s->m;
    int keep = c->derivatives && !c->has->projects;
    memset(w->T, 0, (size_t)((d + 1) * (d + 1)) * sizeof(double));
    for (int64_t start = 0; start < m; start += CHUNK) {
        int64_t rows = m - start < CHUNK ? m - start : CHUNK;
        p->slopes(p->slope_tape, w->theta, p->X, p->N, start, start + rows, w->slopes, CHUNK);
        int64_t n = order_columns(s, c, only_linear, rows);
        double *last = w->chunk + n * CHUNK;
        if (keep) {
            for (int64_t k = 0; k < d; k++)
                copy(w->chunk + k * CHUNK, c->derivatives + k * m + start, rows);
            copy(c->derivatives + d * m + start, last, rows);
        } else {
            p->residuals(p->value_tape, w->theta, p->X, p->N, p->y, start, start + rows, last);
        }
        for (int64_t k = 0; k <= n; k++) pad(w->chunk + k * CHUNK, rows);
        p->sums->fold(w->T, d + 1, w->chunk, CHUNK, whole(rows), n + 1, w->solver.by);
        if (is_stopped(s)) return;
    }
}

/* List an improvement over all rows, found with the last m of the rows used, except for `more`. */
static void list_improvement(search *s, double loss, int64_t more) {
    int64_t k = s->tally[IMPROVEMENTS]++;
    s->at[k] = s->tally[SPENT] - more;
    s->best = s->losses[k] = loss;
    copy(s->w.theta, s->thetas + k * s->p.d, s->p.d);
}

/* Bring a candidate to its next evaluation, and make it; returns RUNNING, or how this ended. A factor
   that a stop has left is a step of its own, so that a second stop undoes nothing of it. */
static int make_step(search *s, candidate *c) {
    const problem *p = &s->p;
    if (c->has->stage == FACTOR && c->derivatives) {
        factor_secant(s, c);
        return RUNNING;
    }
    int needs = prepare(s, c);
    if (is_stopped(s)) return PAUSED;
    if (!needs) return FINISHED;
    int64_t stage = c->has->stage, m = s->m;
    int project = c->has->projects && stage != RECORD;
    int64_t cost = stage == SLOPES ? m * s->settings.slope_cost
        : m * (project ? p->linears + 1 : 1);
    if (cost > s->most - s->tally[SPENT] || s->tally[IMPROVEMENTS] >= s->events) return PAUSED;
    s->tally[SPENT] += cost;
    c->has->spent += cost;
    /* Derivatives at its position. */
    if (stage == SLOPES) {
        to_units(p, c->x, s->w.theta);
        fill(s, c, 0);
        if (is_stopped(s)) return PAUSED;
        take_factor(s, c);
        s->tally[UNUSABLES] += c->has->stage == UNUSABLE;
        return RUNNING;
    }
    /* Or an evaluation of its trial, recorded if it is an improvement over all rows. */
    to_units(p, stage == RECORD ? c->x : c->trial, s->w.theta);
    double loss = look(s, c->derivatives && !project) / (double)m;
    s->tally[NANS] += isnan(loss) != 0;
    s->tally[INFINITIES] += isinf(loss) != 0;
    if (s->rules.last && loss < s->best) list_improvement(s, loss, cost - m);
    /* Solve for the linear parameters. */
    if (project && isfinite(loss)) {
        fill(s, c, 1);
        loss = solve_linear(s, c);
        if (is_stopped(s)) return PAUSED;
    }
    after_evaluation(s, c, loss);
    return s->best <= s->target ? REACHED : RUNNING;
}

/* Give a candidate its steps, one evaluation after the other, until it needs none. A step that is
   stopped is undone, unless it has moved the candidate and only its factor is left. */
int descend(search *s, int64_t i) {
    candidate c = candidate_at(s, i);
    int ended = RUNNING;
    while (ended == RUNNING) {
        candidate_numbers numbers = *c.is;
        candidate_counts counts = *c.has;
        double best = s->best;
        int64_t tally[TALLIES];
        memcpy(tally, s->tally, sizeof tally);
        ended = make_step(s, &c);
        if (!is_stopped(s)) continue;
        ended = PAUSED;
        if (c.has->stage == FACTOR) continue;
        *c.is = numbers;
        *c.has = counts;
        s->best = best;
        memcpy(s->tally, tally, sizeof tally);
    }
    return ended;
}
