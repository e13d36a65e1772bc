/* Levenberg-Marquardt steps of one candidate. miho/compiled/gauss_newton.py says the same in
   Python, for residuals that come from there. */
#include <math.h>
#include <string.h>
#include "elementary.h"
#include "search.h"

/* Gain over predicted gain: above the first a trial is taken; above the second the damping falls,
   below the third it grows (Marquardt, 1963; More, 1978). */
#define ACCEPTED 1e-4
#define GOOD 0.75
#define POOR 0.25
/* Factors of the damping after a good and after a poor step; after failures Nielsen's (1999), which
   double each time. */
#define LESS 0.1
#define MORE 2.0
#define SMALLEST_DAMPING 1e-12
#define LARGEST_DAMPING 1e12
/* Where the gain is more than this share of the predicted one the next derivatives are Broyden's, a
   few times running: they cost nothing. */
#define SECANT 0.7
/* Where the predicted gain is below the tolerance, a candidate is done if the damping is no more
   than the first, or the gain no more than the second share of the tolerance; else the damping may
   be the reason, and falls. */
#define DONE_DAMPING 1e-3
#define DONE_LESS 1e-3
#define TRIES 12                /* with less damping, before the last promises too little */
#define RESTART_DAMPING 1e-6    /* the least damping after a step that failed */
#define SMALLEST_SCALE 1e-10    /* as a share of the largest: of parameters without effect */
#define INSIDE 1e-12            /* nearer to a bound, in widths, a parameter is at it */
/* A candidate is a copy of a better one within this squared distance, in units of d / rows of the
   loss, if their losses differ by less than this share. */
#define COPY 0.5
#define COPY_LOSS 0.05

static double larger(double a, double b) { return b > a ? b : a; }
static double smaller(double a, double b) { return b < a ? b : a; }
static double between(double low, double x, double high) {
    return smaller(larger(x, low), high);
}
static void copy(const double *from, double *to, int64_t n) {
    memcpy(to, from, (size_t)n * sizeof(double));
}

/* Whether a coordinate is off the bounds. */
static int is_free(double x) { return INSIDE < x && x < 1 - INSIDE; }

/* How many parameters steps of a candidate move, and which the k-th of them is. */
static int64_t moved(const problem *p, const candidate *c) {
    return c->has->projects ? p->nonlinears : p->d;
}
static int64_t moved_at(const problem *p, const candidate *c, int64_t k) {
    return c->has->projects ? p->nonlinear[k] : k;
}

/* The configuration at unit coordinates x, in units. */
static void to_units(const problem *p, const double *x, double *theta) {
    for (int64_t k = 0; k < p->d; k++) {
        double value = p->origin[k] + p->width[k] * x[k];
        if (p->log[k]) value = exp_of(value);
        theta[k] = between(p->low[k], value, p->high[k]);
    }
}

/* Set R, q and D of a candidate from w.T, the triangular factor of derivatives and residuals. The
   columns of w.T are the d parameters and the residuals; or, where the linear parameters are
   projected out, first the free linear ones, then the nonlinear ones and the residuals. The rows
   below the first are then Kaufman's (1975) Jacobian of the reduced problem. */
static void take_factor(const search *s, candidate *c) {
    const problem *p = &s->p;
    int64_t d = p->d, side = d + 1, n = moved(p, c), first = 0;
    if (c->has->projects)
        for (int64_t k = 0; k < p->linears; k++) first += is_free(c->x[p->linear[k]]);
    /* A scale is the norm of its column, and falls slowly. */
    int finite = 1;
    double largest = 0.0;
    for (int64_t k = 0; k < n; k++) {
        double square = 0.0;
        for (int64_t j = 0; j < n; j++) {
            double value = j <= k ? s->w.T[(first + j) * side + first + k] : 0.0;
            c->R[j * d + k] = value;
            square += value * value;
        }
        c->q[k] = s->w.T[(first + k) * side + first + n];
        c->D[k] = larger(sqrt(square), c->is->fading * c->D[k]);
        largest = larger(largest, c->D[k]);
        finite = finite && isfinite(c->D[k]) && isfinite(c->q[k]);
    }
    for (int64_t k = 0; k < n; k++) c->D[k] = larger(c->D[k], SMALLEST_SCALE * largest);
    c->has->stage = finite ? READY : UNUSABLE;
    if (finite && n && largest == 0) c->has->stage = DONE;
}

/* Store the residuals of a candidate beside its derivatives, if there is room for them. */
static void keep_residuals(const search *s, candidate *c) {
    if (c->derivatives) copy(s->w.residuals, c->derivatives + s->p.d * s->m, s->m);
}

/* Broyden's update of the derivatives after a trial, in the metric of the scales D, and their
   factor. */
static void take_secant(search *s, candidate *c) {
    int64_t d = s->p.d, m = s->m;
    double total = 0.0;
    for (int64_t k = 0; k < d; k++) {
        double scaled = c->D[k] * (c->trial[k] - c->x[k]);
        s->w.step[k] = c->trial[k] - c->x[k];
        total += scaled * scaled;
    }
    s->p.sums->update_columns(c->derivatives, s->w.residuals, s->w.step, c->D, total, d, m);
    memset(s->w.T, 0, (size_t)((d + 1) * (d + 1)) * sizeof(double));
    for (int64_t start = 0; start < m; start += CHUNK) {
        int64_t rows = m - start < CHUNK ? m - start : CHUNK;
        for (int64_t k = 0; k <= d; k++)
            copy(c->derivatives + k * m + start, s->w.chunk + k * CHUNK, rows);
        s->p.sums->fold(s->w.T, d + 1, s->w.chunk, CHUNK, rows, d + 1);
    }
}

/* Move a candidate to its trial, whose gain is rho times the predicted one. */
static void accept(search *s, candidate *c, double loss, double rho) {
    int secant = rho > SECANT && c->has->secants < s->rules.secants && c->derivatives &&
        !c->has->projects;
    if (secant) take_secant(s, c);
    else keep_residuals(s, c);
    /* Trust the linear model more or less. */
    copy(c->trial, c->x, s->p.d);
    c->is->loss = loss;
    if (rho > GOOD) c->is->damping = larger(LESS * c->is->damping, SMALLEST_DAMPING);
    else if (rho < POOR) c->is->damping *= MORE;
    c->is->growth = 2.0;
    c->has->stage = SLOPES;
    if (secant) {
        c->has->secants++;
        take_factor(s, c);
        if (c->has->stage == UNUSABLE) {
            c->has->stage = SLOPES;
            c->has->secants = 0;
        }
    }
    if (loss <= s->rules.rounding) c->has->stage = DONE;
}

/* Accept or refuse the trial of a candidate by its loss; its residuals are in w. */
static void judge_trial(search *s, candidate *c, double loss) {
    /* A first look is no trial: it gives the loss that later ones are compared with. */
    if (c->has->stage == ENTER) {
        copy(c->trial, c->x, s->p.d);
        c->is->loss = c->is->loss_at_mark = loss;
        c->has->stage = isfinite(loss) ? SLOPES : UNUSABLE;
        c->has->spent_at_mark = c->has->spent;
        keep_residuals(s, c);
        return;
    }
    c->has->trials++;
    double actual = (c->is->loss - loss) * (double)s->m, predicted = c->is->predicted_gain;
    double rho = predicted > 0 && isfinite(loss) ? actual / predicted : -1.0;
    if (rho > ACCEPTED) {
        accept(s, c, loss, rho);
    } else if (c->has->secants) {
        /* Updated derivatives may be the reason, so evaluate them. */
        c->has->stage = SLOPES;
        c->has->secants = 0;
    } else {
        c->is->damping = larger(c->is->damping * c->is->growth, RESTART_DAMPING);
        c->is->growth *= 2.0;
        c->has->stage = c->is->damping > LARGEST_DAMPING ? DONE : READY;
    }
}

/* Set the trial to x + w.step in the box. A step that rounding makes none ends the descent. */
static void set_trial(const search *s, candidate *c) {
    int differs = 0;
    copy(c->x, c->trial, s->p.d);
    for (int64_t k = 0; k < moved(&s->p, c); k++) {
        int64_t at = moved_at(&s->p, c, k);
        c->trial[at] = between(0.0, c->x[at] + s->w.step[k], 1.0);
        differs = differs || c->trial[at] != c->x[at];
    }
    c->has->stage = differs ? TRIED : DONE;
}

/* Set the next trial of a candidate whose derivatives are known; or it is done. */
static void propose_trial(search *s, candidate *c) {
    const work_room *w = &s->w;
    int64_t n = moved(&s->p, c);
    if (n == 0) {
        c->has->stage = DONE;
        c->is->predicted_gain = 0.0;
        return;
    }
    /* The step stays in the box, and within reach. */
    double square = 0.0, total = c->is->loss * (double)s->m;
    for (int64_t k = 0; k < n; k++) {
        double at = c->x[moved_at(&s->p, c, k)];
        w->low[k] = larger(-at, -s->rules.reach);
        w->high[k] = smaller(1 - at, s->rules.reach);
        square += c->q[k] * c->q[k];
    }
    /* Solve with less and less damping until the linear model promises enough. */
    box_problem b = {c->R, c->q, w->scale, w->low, w->high, s->p.d, 1, n};
    for (int count = 0; count < TRIES; count++) {
        double root = sqrt(c->is->damping);
        for (int64_t k = 0; k < n; k++) w->scale[k] = root * c->D[k];
        solve_in_box(&b, w->step, &w->solver);
        c->is->predicted_gain = square - square_norm(&b, w->step);
        double predicted = total > 0 ? c->is->predicted_gain / total : 0.0;
        if (predicted > s->rules.tolerance) break;
        if (c->is->damping <= DONE_DAMPING || predicted <= DONE_LESS * s->rules.tolerance) {
            c->has->stage = DONE;
            if (c->has->secants && s->rules.last) { /* by updated derivatives: evaluate them */
                c->has->stage = SLOPES;
                c->has->secants = 0;
            }
            return;
        }
        c->is->damping *= LESS;
    }
    set_trial(s, c);
}

/* |R (x_c - x)|^2: by how much the linear model of a candidate changes on the way to x. */
static double square_distance(const problem *p, const candidate *c, const double *x) {
    int64_t n = moved(p, c);
    double total = 0.0;
    for (int64_t row = 0; row < n; row++) {
        double value = 0.0;
        for (int64_t k = row; k < n; k++) {
            int64_t at = moved_at(p, c, k);
            value += c->R[row * p->d + k] * (c->x[at] - x[at]);
        }
        total += value * value;
    }
    return total;
}

/* Whether a candidate is a copy of a better one as far as the rows can tell. */
int is_copy(const search *s, const candidate *better, const candidate *c) {
    int modelled = better->has->stage == READY || better->has->stage == DONE;
    int close = c->is->loss - better->is->loss <= COPY_LOSS * better->is->loss;
    return modelled && close &&
        square_distance(&s->p, better, c->x) <= COPY * (double)s->p.d * better->is->loss;
}

/* Whether a candidate is on its way to a minimum that is known, and no better. */
static int nears_known_minimum(const search *s, const candidate *c) {
    const known_minima *known = &s->minima;
    double near = s->rules.near * c->is->loss * (double)s->m;
    if (!s->rules.ending) return 0;
    for (int64_t k = 0; k < known->count; k++) {
        double loss = known->sums[k * s->p.levels + s->rules.level] / (double)s->m;
        int worse = known->determined[k] && c->is->loss >= loss * (1 - s->rules.better);
        if (worse && square_distance(&s->p, c, known->x + k * s->p.d) <= near) return 1;
    }
    return 0;
}

/* Whether a candidate gains too little for the rows it costs, and has spent its allowance. */
static int crawls(const search *s, candidate *c) {
    const step_rules *rules = &s->rules;
    if (!rules->patience || c->has->spent - c->has->spent_at_mark < rules->patience) return 0;
    if (c->is->loss > (1 - rules->progress) * c->is->loss_at_mark)
        return c->has->spent >= rules->allowance;
    c->has->spent_at_mark = c->has->spent;
    c->is->loss_at_mark = c->is->loss;
    return 0;
}

/* Bring a candidate to its next evaluation; 0 where it needs none in this block. */
static int prepare(search *s, candidate *c) {
    while (c->has->stage == SLOPES || c->has->stage == READY) {
        if (c->has->stage == READY && nears_known_minimum(s, c)) c->has->stage = AT_KNOWN;
        else if (c->has->trials >= s->rules.steps || crawls(s, c)) return 0;
        else if (c->has->stage == SLOPES) return 1;
        else propose_trial(s, c);
    }
    return c->has->stage < DONE;
}

/* Move a trial to its best linear parameters, and give the loss there, by algebra. w.T is the
   triangular factor of their columns, in box widths, and of the residuals at w.theta. The loss is
   infinite where that is not finite. */
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
    double rest = w->T[n * side + n], square = rest * rest + square_norm(&b, w->step);
    for (int64_t j = 0; j < n; j++) {
        int64_t k = p->linear[j];
        double value = w->theta[k] + (p->high[k] - p->low[k]) * w->step[j];
        value = between(p->low[k], value, p->high[k]);
        if (p->log[k]) value = log_of(value);
        c->trial[k] = between(0.0, (value - p->origin[k]) / p->width[k], 1.0);
    }
    return square / (double)s->m;
}

/* Take a candidate on after an evaluation, with the loss that residuals or algebra gave. The loss
   at solved linear parameters is known by algebra only: on all rows an improvement is evaluated
   once more (RECORD), so that what the run records was evaluated. */
static void after_evaluation(search *s, candidate *c, double loss) {
    if (c->has->stage == RECORD) {
        c->has->stage = c->has->stage_after_record;
        copy(s->w.sums, c->sums, s->p.levels);
        return;
    }
    double previous = c->is->loss;
    judge_trial(s, c, loss);
    if (c->has->projects) {
        if (s->rules.last && c->is->loss < previous && c->is->loss < s->best) {
            c->has->stage_after_record = c->has->stage;
            c->has->stage = RECORD;
        }
    } else if (c->is->loss < previous) {
        copy(s->w.sums, c->sums, s->p.levels);
    }
}

/* The sum of squares at w.theta over the rows of this level, and in w.sums those over the rows of
   each. The residuals are left in w.residuals if they are to `keep`. */
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

/* Derivatives in units as those in a coordinate of which 1 is this width. */
static void scale_column(const double *slopes, double width, int64_t rows, double *scaled) {
    for (int64_t i = 0; i < rows; i++) scaled[i] = slopes[i] * width;
}

/* Scale the columns in w.slopes into w.chunk, in the order that `take_factor` expects, or those of
   the linear parameters; how many. */
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
   the linear parameters only, in box widths, or of those that `take_factor` expects. */
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
        p->sums->fold(w->T, d + 1, w->chunk, CHUNK, rows, n + 1);
    }
}

/* List an improvement over all rows, found with the last m of the rows spent but for `more`. */
static void list_improvement(search *s, double loss, int64_t more) {
    int64_t k = s->tally[IMPROVEMENTS]++;
    s->at[k] = s->tally[SPENT] - more;
    s->best = s->losses[k] = loss;
    copy(s->w.theta, s->thetas + k * s->p.d, s->p.d);
}

/* Give a candidate its steps, one evaluation after the other, until it needs none. */
int descend(search *s, int64_t i) {
    const problem *p = &s->p;
    candidate c = candidate_at(s, i);
    while (prepare(s, &c)) {
        int64_t stage = c.has->stage, m = s->m;
        int project = c.has->projects && stage != RECORD;
        int64_t cost = stage == SLOPES ? m * s->settings.slope_cost
            : m * (project ? p->linears + 1 : 1);
        if (cost > s->most - s->tally[SPENT] || s->tally[IMPROVEMENTS] >= s->events) return PAUSED;
        s->tally[SPENT] += cost;
        c.has->spent += cost;
        /* Derivatives, where it is. */
        if (stage == SLOPES) {
            to_units(p, c.x, s->w.theta);
            fill(s, &c, 0);
            take_factor(s, &c);
            s->tally[UNUSABLES] += c.has->stage == UNUSABLE;
            continue;
        }
        /* Or a look at its trial, recorded if it is an improvement over all rows. */
        to_units(p, stage == RECORD ? c.x : c.trial, s->w.theta);
        double loss = look(s, c.derivatives && !project) / (double)m;
        s->tally[NANS] += isnan(loss) != 0;
        s->tally[INFINITIES] += isinf(loss) != 0;
        if (s->rules.last && loss < s->best) list_improvement(s, loss, cost - m);
        /* The linear parameters are solved for from there. */
        if (project && isfinite(loss)) {
            fill(s, &c, 1);
            loss = solve_linear(s, &c);
        }
        after_evaluation(s, &c, loss);
        if (s->best <= s->target) return REACHED;
    }
    return FINISHED;
}
