/* Levenberg-Marquardt steps of one candidate, between two evaluations. Python form, for residuals
   from Python: miho/compiled/gauss_newton.py. */
#include <math.h>
#include <string.h>
#include "search.h"

/* Ratios of gain to predicted gain: above the first a trial is accepted, above the second the
   damping decreases, below the third it increases (Marquardt, 1963; More, 1978). */
#define ACCEPTED 1e-4
#define GOOD 0.75
#define POOR 0.25
/* Factors of the damping after a good and a poor step; after failures Nielsen's (1999) factors,
   which double each time. */
#define LESS 0.1
#define MORE 2.0
#define SMALLEST_DAMPING 1e-12
#define LARGEST_DAMPING 1e12
/* If the gain exceeds this share of the predicted one, the next derivatives are Broyden updates, a
   few times in a row: they cost nothing. */
#define SECANT 0.7
/* A rejected trial is corrected for curvature if this turns its step by at most this share, in the
   metric of the scales (Transtrum and Sethna, 2012). */
#define BEND 0.75
#define CORRECTED (-1)  /* value of `secants`: the trial is corrected */
/* If the predicted gain is below the tolerance, a candidate is done if the damping is at most the
   first value, or the gain at most the second share of the tolerance; otherwise the damping may be
   the reason, and decreases. */
#define DONE_DAMPING 1e-3
#define DONE_LESS 1e-3
#define TRIES 12                /* decreases of the damping before a last trial */
#define RESTART_DAMPING 1e-6    /* smallest damping after a failed step */
#define SMALLEST_SCALE 1e-10    /* relative to the largest scale */
#define INSIDE 1e-12            /* a parameter is at a closer bound, in widths */
/* A candidate is a copy of a better one within this squared distance, in units of d / rows of the
   loss, if their losses differ by less than this share. */
#define COPY 0.5
#define COPY_LOSS 0.05

/* Whether a coordinate is off the bounds. */
int is_free(double x) { return INSIDE < x && x < 1 - INSIDE; }

/* Number of parameters that the steps of a candidate move, and the k-th of them. */
static int64_t moved(const problem *p, const candidate *c) {
    return c->has->projects ? p->nonlinears : p->d;
}
static int64_t moved_at(const problem *p, const candidate *c, int64_t k) {
    return c->has->projects ? p->nonlinear[k] : k;
}

/* Set R, q and D of a candidate from w.T, the triangular factor of derivatives and residuals. The
   columns of w.T are the d parameters and the residuals; with projection, first the free linear
   parameters, then the nonlinear ones and the residuals. The rows below the first ones are then
   Kaufman's (1975) Jacobian of the reduced problem. */
void take_factor(const search *s, candidate *c) {
    const problem *p = &s->p;
    int64_t d = p->d, side = d + 1, n = moved(p, c), first = 0;
    if (c->has->projects)
        for (int64_t k = 0; k < p->linears; k++) first += is_free(c->x[p->linear[k]]);
    /* A scale is the norm of its column, and decreases slowly. */
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

/* Store the residuals of a candidate with its derivatives, if there is room for them. */
static void keep_residuals(const search *s, candidate *c) {
    if (c->derivatives) copy(s->w.residuals, c->derivatives + s->p.d * s->m, s->m);
}

/* Triangular factor of the stored derivatives and of the residuals `last`, into w.T. */
static void refold(const search *s, const candidate *c, const double *last) {
    int64_t d = s->p.d, m = s->m;
    memset(s->w.T, 0, (size_t)((d + 1) * (d + 1)) * sizeof(double));
    for (int64_t start = 0; start < m; start += CHUNK) {
        int64_t rows = m - start < CHUNK ? m - start : CHUNK;
        for (int64_t k = 0; k < d; k++)
            copy(c->derivatives + k * m + start, s->w.chunk + k * CHUNK, rows);
        copy(last + start, s->w.chunk + d * CHUNK, rows);
        for (int64_t k = 0; k <= d; k++) pad(s->w.chunk + k * CHUNK, rows);
        s->p.sums->fold(s->w.T, d + 1, s->w.chunk, CHUNK, whole(rows), d + 1,
                       s->w.solver.by);
    }
}

/* Broyden update of the derivatives after a trial, in the metric of the scales D. It cannot be
   undone. */
static void take_secant(const search *s, const candidate *c) {
    int64_t d = s->p.d;
    double total = 0.0;
    for (int64_t k = 0; k < d; k++) {
        double scaled = c->D[k] * (c->trial[k] - c->x[k]);
        s->w.step[k] = c->trial[k] - c->x[k];
        total += scaled * scaled;
    }
    s->p.sums->update_columns(c->derivatives, s->w.residuals, s->w.step, c->D, total, d, s->m);
}

/* Factor of the updated derivatives at the position of a candidate. */
void factor_secant(search *s, candidate *c) {
    c->has->stage = FACTOR;
    refold(s, c, c->derivatives + s->p.d * s->m);
    if (is_stopped(s)) return;
    take_factor(s, c);
    if (c->has->stage == UNUSABLE) {
        c->has->stage = SLOPES;
        c->has->secants = 0;
    }
    if (c->is->loss <= s->rules.rounding) c->has->stage = DONE;
}

/* Move a candidate to its trial, whose gain is rho times the predicted one. */
static void accept(search *s, candidate *c, double loss, double rho) {
    c->has->secants = c->has->secants > 0 ? c->has->secants : 0;
    int secant = rho > SECANT && c->has->secants < s->rules.secants && c->derivatives &&
        !c->has->projects;
    if (secant) take_secant(s, c);
    else keep_residuals(s, c);
    /* Adapt the damping. */
    copy(c->trial, c->x, s->p.d);
    c->is->loss = loss;
    if (rho > GOOD) c->is->damping = larger(LESS * c->is->damping, SMALLEST_DAMPING);
    else if (rho < POOR) c->is->damping *= MORE;
    c->is->growth = 2.0;
    c->has->stage = loss <= s->rules.rounding ? DONE : SLOPES;
    if (!secant) return;
    c->has->secants++;
    factor_secant(s, c);
}

/* Limits of a step along each coordinate: the box, and `reach`. */
static void set_limits(const search *s, const candidate *c, int64_t n) {
    for (int64_t k = 0; k < n; k++) {
        double at = c->x[moved_at(&s->p, c, k)];
        s->w.low[k] = larger(-at, -s->rules.reach);
        s->w.high[k] = smaller(1 - at, s->rules.reach);
    }
}

/* Damping of n coordinates as square roots. The stronger the damping, the more equally coordinates
   count. A scale is the size of a parameter's derivatives at the candidate; long steps along
   parameters without effect there would be rejected. Without `alike` the scales alone count: on
   fewer than all rows, where there are many candidates and steps are cheap, and to decide whether a
   descent is done. */
static void set_damping(const search *s, const candidate *c, int64_t n, int alike) {
    double largest = 0.0, root = sqrt(c->is->damping);
    for (int64_t k = 0; k < n; k++) largest = larger(largest, c->D[k]);
    double least = alike ? smaller(c->is->damping, 1.0) * largest * largest : 0.0;
    for (int64_t k = 0; k < n; k++) s->w.scale[k] = root * sqrt(c->D[k] * c->D[k] + least);
}

/* Correct a rejected trial for the curvature that its residuals, in w, show. Along the step v the
   residuals are r + J v + b, with bend b. The corrected step minimises |J s + r + b|^2 with the
   same damping: to second order it is v plus half the geodesic acceleration (Transtrum and Sethna,
   2012), without further derivatives. 0 if derivatives are not stored, or are updated ones, if the
   trial was corrected already, or if it would turn too far. */
static int correct_trial(search *s, candidate *c) {
    const work_room *w = &s->w;
    int64_t d = s->p.d, side = d + 1;
    if (!c->derivatives || c->has->projects || c->has->secants) return 0;
    /* Q' (r + b) from the residuals of the trial. */
    refold(s, c, w->residuals);
    if (is_stopped(s)) return 0;
    for (int64_t k = 0; k < d; k++) {
        double *q = w->T + k * side + d;
        for (int64_t j = k; j < d; j++) *q -= c->R[k * d + j] * (c->trial[j] - c->x[j]);
        if (!isfinite(*q)) return 0;
    }
    set_limits(s, c, d);
    set_damping(s, c, d, s->rules.last != 0);
    box_problem b = {c->R, w->T + d, w->scale, w->low, w->high, d, side, d};
    solve_in_box(&b, w->step, &w->solver);
    if (is_stopped(s)) return 0;
    double turn = 0.0, length = 0.0;
    for (int64_t k = 0; k < d; k++) {
        double before = c->D[k] * (c->trial[k] - c->x[k]);
        double change = c->D[k] * w->step[k] - before;
        turn += change * change;
        length += before * before;
    }
    if (turn > BEND * BEND * length) return 0;
    for (int64_t k = 0; k < d; k++) c->trial[k] = between(0.0, c->x[k] + w->step[k], 1.0);
    return 1;
}

/* Accept or reject the trial of a candidate by its loss; its residuals are in w. */
static void judge_trial(search *s, candidate *c, double loss) {
    /* The first evaluation gives the loss with which trials are compared. */
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
    } else if (c->has->secants > 0) {
        /* Evaluate the derivatives, in case the update was wrong. */
        c->has->stage = SLOPES;
        c->has->secants = 0;
    } else if (isfinite(loss) && correct_trial(s, c)) {
        c->has->secants = CORRECTED;
    } else {
        c->has->secants = 0;
        c->is->damping = larger(c->is->damping * c->is->growth, RESTART_DAMPING);
        c->is->growth *= 2.0;
        c->has->stage = c->is->damping > LARGEST_DAMPING ? DONE : READY;
    }
}

/* Set the trial to x + w.step in the box. A step that rounding removes ends the descent. */
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

/* Set the next trial of a candidate with known derivatives, or mark it as done. */
static void propose_trial(search *s, candidate *c) {
    const work_room *w = &s->w;
    int64_t n = moved(&s->p, c);
    if (n == 0) {
        c->has->stage = DONE;
        c->is->predicted_gain = 0.0;
        return;
    }
    double square = 0.0, total = c->is->loss * (double)s->m;
    for (int64_t k = 0; k < n; k++) square += c->q[k] * c->q[k];
    set_limits(s, c, n);
    /* Decrease the damping until the predicted gain is large enough. */
    box_problem b = {c->R, c->q, w->scale, w->low, w->high, s->p.d, 1, n};
    int on_all = s->rules.last != 0;
    for (int count = 0; count < TRIES; count++) {
        double predicted = 0.0;
        for (int alike = on_all; alike >= 0 && !(predicted > s->rules.tolerance); alike--) {
            set_damping(s, c, n, alike);
            solve_in_box(&b, w->step, &w->solver);
            if (is_stopped(s)) return;
            c->is->predicted_gain = square - square_norm(&b, w->step);
            predicted = total > 0 ? c->is->predicted_gain / total : 0.0;
        }
        if (predicted > s->rules.tolerance) break;
        if (c->is->damping <= DONE_DAMPING || predicted <= DONE_LESS * s->rules.tolerance) {
            c->has->stage = DONE;
            if (c->has->secants && s->rules.last) { /* updated derivatives: evaluate first */
                c->has->stage = SLOPES;
                c->has->secants = 0;
            }
            return;
        }
        c->is->damping *= LESS;
    }
    set_trial(s, c);
}

/* |R (x_c - x)|^2: the change of a candidate's linear model from x_c to x. */
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

/* Whether a candidate is a copy of a better one as far as the rows show. */
int is_copy(const search *s, const candidate *better, const candidate *c) {
    int modelled = better->has->stage == READY || better->has->stage == DONE;
    int close = c->is->loss - better->is->loss <= COPY_LOSS * better->is->loss;
    return modelled && close &&
        square_distance(&s->p, better, c->x) <= COPY * (double)s->p.d * better->is->loss;
}

/* Whether a candidate is on its way to a known minimum, and no better. */
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

/* Whether a candidate gains too little for its rows, and has used its allowance. */
static int crawls(const search *s, candidate *c) {
    const step_rules *rules = &s->rules;
    if (!rules->patience || c->has->spent - c->has->spent_at_mark < rules->patience) return 0;
    if (c->is->loss > (1 - rules->progress) * c->is->loss_at_mark)
        return c->has->spent >= rules->allowance;
    c->has->spent_at_mark = c->has->spent;
    c->is->loss_at_mark = c->is->loss;
    return 0;
}

/* Bring a candidate to its next evaluation; 0 if it needs none in this block. */
int prepare(search *s, candidate *c) {
    while (!is_stopped(s) && (c->has->stage == SLOPES || c->has->stage == READY)) {
        if (c->has->stage == READY && nears_known_minimum(s, c)) c->has->stage = AT_KNOWN;
        else if (c->has->trials >= s->rules.steps || crawls(s, c)) return 0;
        else if (c->has->stage == SLOPES) return 1;
        else propose_trial(s, c);
    }
    return c->has->stage < DONE;
}

/* Advance a candidate after an evaluation, with the loss from residuals or from algebra. The loss
   at solved linear parameters is known by algebra only. On all rows an improvement is evaluated
   once more (RECORD), so that every recorded loss was evaluated. */
void after_evaluation(search *s, candidate *c, double loss) {
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
