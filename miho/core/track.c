/* Population of hypotheses, see track.h. Nothing in its memory is an index, so that no content can
   lead out of bounds. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "elementary.h"
#include "track.h"

#define EMPTY (-1e9)
#define LEAST_WEIGHT (-1e6)
#define SMALLEST 1e-300
#define LARGEST_NOISE 1e6
#define BEYOND 1e150           /* errors and deviations whose squares leave the range of doubles */
#define RISE 1.02
#define TOGETHER 0.5
#define OVER 0.01              /* share of a burst, or of an inlier, that no longer counts */

enum { ROW, CLOCK, LAST_TIME, SINCE, QUIET_UNTIL, TURN, ODDS, ALARM, GAIN, NUMBERS };
enum { HAZARD, ONSET, OUTLIERS, WIDTH, THRESHOLD, NEAR, LONG, MIDDLE, SHORT, USE, SMOOTH, HOLD,
       REPEATS, GAP, EVERY, CAP, STEP_ERROR, BURST, SETTLE, WRONG, RULES };

typedef struct {
    const double *number, *unit, *low, *high, *watched, *sigma, *noise;
} rules_of;

typedef struct {
    double *number, *theta, *P, *share, *weight, *drift, *calm, *born, *was, *peak, *informed,
        *mean, *variance, *last, *repeats, *measured;
} population;

/* Room for one update: columns and results of the tape, inputs and their noise, usable outputs,
   shares of the variance that are new, and units of parameters and states. States that `began` at
   the values of the row may have to begin `again`. The others are of one hypothesis. */
typedef struct {
    double *X, *results, *row, *noise, *y, *grown, *unit;
    double *before, *taught, *Pj, *step, *onward, *carried;
    uint8_t *teaches, *is_free;
    double inlier;
    int any, counts;
    uint64_t began, again;
} desk;

int64_t length_of_memory(const track_sizes *of) {
    int64_t K = of->K, d = of->d, D = d + of->n;
    return NUMBERS + K * (D * D + D + 2 * d + 4) + 2 * d + 2 * of->q + 2 * (of->q + of->m) + of->n;
}
int64_t length_of_rules(const track_sizes *of) { return RULES + 4 * of->d + of->m + of->q; }
int64_t length_of_estimate(const track_sizes *of) {
    return of->d + of->d * of->d + of->K * (1 + 2 * of->d);
}

static double *next(double **at, int64_t n) {
    double *here = *at;
    *at += n;
    return here;
}

static population population_in(const track_sizes *of, double *memory) {
    int64_t K = of->K, d = of->d, D = d + of->n, q = of->q, seen = q + of->m;
    double *at = memory;
    population p;
    p.number = next(&at, NUMBERS);
    p.theta = next(&at, K * D);
    p.P = next(&at, K * D * D);
    p.share = next(&at, K * d);
    p.weight = next(&at, K);
    p.drift = next(&at, K);
    p.calm = next(&at, K);
    p.born = next(&at, K);
    p.was = next(&at, K * d);
    p.peak = next(&at, d);
    p.informed = next(&at, d);
    p.mean = next(&at, q);
    p.variance = next(&at, q);
    p.last = next(&at, seen);
    p.repeats = next(&at, seen);
    p.measured = next(&at, of->n);
    return p;
}

static rules_of rules_in(const track_sizes *of, const double *rules) {
    int64_t d = of->d;
    const double *unit = rules + RULES;
    return (rules_of){rules, unit, unit + d, unit + 2 * d, unit + 3 * d, unit + 4 * d,
                      unit + 4 * d + of->m};
}

static int open_desk(const track_sizes *of, const rules_of *rules, desk *to) {
    int64_t K = of->K, d = of->d, D = d + of->n, each = 1 + d + of->q;
    int64_t columns = (of->p + d) * K, results = of->m * each * K;
    int64_t count = columns + results + of->p + of->q + of->m + K * d + d + (4 + 2 * of->n) * D;
    double *at = malloc((size_t)count * sizeof(double) + (size_t)(K + D));
    if (!at) return 0;
    to->X = next(&at, columns);
    to->results = next(&at, results);
    to->row = next(&at, of->p);
    to->noise = next(&at, of->q);
    to->y = next(&at, of->m);
    to->grown = next(&at, K * d);
    to->unit = next(&at, D);
    to->before = next(&at, D);
    to->taught = next(&at, d);
    to->Pj = next(&at, D);
    to->step = next(&at, D);
    to->onward = next(&at, of->n * D);
    to->carried = next(&at, of->n * D);
    memcpy(to->unit, rules->unit, (size_t)d * sizeof(double));
    memcpy(to->unit + d, rules->noise, (size_t)of->n * sizeof(double));
    to->teaches = (uint8_t *)at;
    to->is_free = to->teaches + K;
    memset(to->teaches, 0, (size_t)K);
    to->began = to->again = 0;
    return 1;
}

static double result_of(const track_sizes *of, const desk *at, int64_t o, int64_t which,
                        int64_t s) {
    return at->results[(o * (1 + of->d + of->q) + which) * of->K + s];
}

/* Advance the clock; returns the seconds that have passed. */
static double pass_time(population *at, const rules_of *rules, double time) {
    double passed = time - at->number[LAST_TIME];
    passed = passed > 0.0 ? passed : 0.0;
    if (passed > rules->number[GAP]) passed = rules->number[GAP];
    at->number[LAST_TIME] = time;
    at->number[CLOCK] += passed;
    return passed;
}

/* Note a value; returns whether it is finite and does not repeat. */
static int is_fresh(population *at, const rules_of *rules, int64_t k, double value) {
    at->repeats[k] = value == at->last[k] ? at->repeats[k] + 1.0 : 0.0;
    at->last[k] = value;
    return isfinite(value) && at->repeats[k] < rules->number[REPEATS];
}

/* Set the usable outputs, NaN for the others. */
static void select_usable(const track_sizes *of, population *at, const rules_of *rules,
                          const double *row, desk *to) {
    int good = 1;
    to->any = 0;
    for (int64_t k = 0; k < of->p; k++) good &= isfinite(row[k]) != 0;
    for (int64_t k = 0; k < of->q; k++) good &= is_fresh(at, rules, k, row[k]);
    for (int64_t o = 0; o < of->m; o++) {
        int fresh = is_fresh(at, rules, of->q + o, row[of->p + o]);
        to->y[o] = good && fresh ? row[of->p + o] : NOT_A_NUMBER;
        to->any |= good && fresh;
    }
}

/* Regression calibration of the inputs with noise. */
static void smooth_inputs(const track_sizes *of, population *at, const rules_of *rules,
                          const double *row, double seconds, desk *to) {
    double b = seconds / rules->number[SMOOTH], first = 1.0 / (at->number[ROW] + 1.0);
    b = b < 1.0 ? b : 1.0;
    b = b > first ? b : first;
    memcpy(to->row, row, (size_t)of->p * sizeof(double));
    for (int64_t k = 0; k < of->q; k++) {
        double square = rules->noise[k] * rules->noise[k];
        if (isinf(at->variance[k]) || b >= 1.0) {
            at->mean[k] = row[k];
            at->variance[k] = LARGEST_NOISE * square;
        } else {
            double away = row[k] - at->mean[k];
            at->mean[k] += b * away;
            at->variance[k] = (1.0 - b) * (at->variance[k] + b * (away * away));
        }
        double shrunk = square / (at->variance[k] > SMALLEST ? at->variance[k] : SMALLEST);
        shrunk = shrunk < 1.0 ? shrunk : 1.0;
        to->row[k] = row[k] - shrunk * (row[k] - at->mean[k]); /* exact with a mean far away */
        to->noise[k] = rules->noise[k] * sqrt(1.0 - shrunk);
    }
}

/* Widen the hypotheses by their drift; the burst of a fresh one widens watched parameters only. */
static void let_drift(const track_sizes *of, population *at, const rules_of *rules,
                      double seconds, desk *to) {
    int64_t d = of->d, D = d + of->n;
    double left = exp_one(-seconds / rules->number[SETTLE]);
    for (int64_t s = 0; s < of->K; s++) {
        double drift = at->drift[s], calm = at->calm[s], more = left * (drift - calm);
        if (at->weight[s] <= EMPTY) continue;
        at->drift[s] = more > OVER * rules->number[BURST] ? calm + more : calm;
        for (int64_t i = 0; i < d; i++) {
            double *variance = at->P + (s * D + i) * D + i;
            double rate = rules->watched[i] > 0.0 ? drift : calm;
            double added = *variance < rules->number[CAP] ? rate * rate * seconds : 0.0;
            *variance += added;
            to->grown[s * d + i] = added / (*variance > SMALLEST ? *variance : SMALLEST);
        }
    }
}

/* Set the state c of hypothesis s to a measured value of a variance. */
static void set_state(const track_sizes *of, population *at, int64_t s, int64_t c, double value,
                      double variance) {
    int64_t D = of->d + of->n, k = of->d + c;
    double *P = at->P + s * D * D;
    at->theta[s * D + k] = value;
    for (int64_t i = 0; i < D; i++) P[k * D + i] = P[i * D + k] = 0.0;
    P[k * D + k] = variance;
}

/* States that the last row did not measure begin at the row's values; all, if one of its values
   differs. */
static void begin_states(const track_sizes *of, population *at, const rules_of *rules,
                         const double *row, desk *to) {
    int other = 0;
    for (int64_t c = 0; c < of->n; c++)
        other |= row[c] != at->measured[c] && isfinite(at->measured[c]);
    for (int64_t c = 0; c < of->n; c++) {
        if (!other && row[c] == at->measured[c]) continue;
        to->began |= 1ull << c;
        double share = to->noise[c] / rules->noise[c];
        for (int64_t s = 0; s < of->K; s++) set_state(of, at, s, c, to->row[c], share * share);
    }
}

static void run_tape(const track_sizes *of, const population *at, workspace *room, desk *to) {
    int64_t K = of->K, d = of->d, D = d + of->n;
    for (int64_t k = 0; k < of->p; k++)
        for (int64_t s = 0; s < K; s++)
            to->X[k * K + s] = k < of->n ? at->theta[s * D + d + k] : to->row[k];
    for (int64_t i = 0; i < d; i++)
        for (int64_t s = 0; s < K; s++) to->X[(of->p + i) * K + s] = at->theta[s * D + i];
    double none = 0.0;
    tape_start(of->tape, &none, room);
    tape_continue(of->tape, to->X, K, 0, K, to->results, K, room);
}

/* The information of the row on a parameter. */
static double information_of(const track_sizes *of, const rules_of *rules, const desk *at,
                             int64_t s, int64_t i) {
    double sum = 0.0;
    for (int64_t o = 0; o < of->m; o++) {
        double j = result_of(of, at, o, 1 + i, s) * rules->unit[i] / rules->sigma[o];
        sum += j * j;
    }
    return sqrt(sum);
}

/* Note the information of a row, and the parameters that it informs. */
static void note(const track_sizes *of, population *at, const rules_of *rules, const desk *from,
                 int64_t best) {
    for (int64_t i = 0; i < of->d; i++)
        if (!isfinite(information_of(of, rules, from, best, i))) return;
    for (int64_t i = 0; i < of->d; i++) {
        double information = information_of(of, rules, from, best, i), peak = at->peak[i];
        double raised = peak > 0.0 && information > RISE * peak ? RISE * peak : information;
        if (raised > peak) at->peak[i] = raised;
        if (information > 0.0 && information >= rules->number[USE] * at->peak[i])
            at->informed[i] = at->number[CLOCK];
    }
}

/* Whether a row weighs the hypotheses: one that informs no watched parameter says nothing on its
   change. */
static int counts(const track_sizes *of, const population *at, const rules_of *rules,
                  const desk *from, int64_t best) {
    int any = 0;
    for (int64_t i = 0; i < of->d; i++) {
        if (rules->watched[i] == 0.0) continue;
        any = 1;
        if (information_of(of, rules, from, best, i) >= rules->number[USE] * at->peak[i]) return 1;
    }
    return !any;
}

/* The variance of output o by noise: of itself and of the inputs from number `first` on. */
static double noise_of(const track_sizes *of, const rules_of *rules, const desk *at, int64_t o,
                       int64_t s, int64_t first) {
    double r = rules->sigma[o] * rules->sigma[o];
    for (int64_t k = first; k < of->q; k++) {
        double slope = result_of(of, at, o, 1 + of->d + k, s) * at->noise[k];
        r += slope * slope;
    }
    return r;
}

/* What output o says on the parameters of hypothesis s: the variance of its prediction by them, in
   that by noise. */
static double worth_of(const track_sizes *of, const population *at, const rules_of *rules,
                       const desk *from, int64_t o, int64_t s) {
    int64_t d = of->d, D = d + of->n;
    double sum = 0.0;
    for (int64_t i = 0; i < d; i++)
        for (int64_t k = 0; k < d; k++)
            sum += result_of(of, from, o, 1 + i, s) * rules->unit[i] * at->P[(s * D + i) * D + k] *
                result_of(of, from, o, 1 + k, s) * rules->unit[k];
    return sum / noise_of(of, rules, from, o, s, 0);
}

/* One Gauss-Newton step of hypothesis s by an error e with the slopes `to->step` and the noise r,
   of a row that is an inlier with probability `to->inlier`; returns the share of the inlier. */
static double step_by(const track_sizes *of, population *at, const rules_of *rules, desk *to,
                      int64_t s, double e, double r) {
    int64_t d = of->d, D = d + of->n;
    double *theta = at->theta + s * D, *P = at->P + s * D * D, *j = to->step, S = 0.0;
    for (int64_t i = 0; i < D; i++) {
        double sum = 0.0;
        for (int64_t k = 0; k < D; k++) sum += P[i * D + k] * j[k];
        to->Pj[i] = sum;
        S += j[i] * sum;
    }
    S += r;
    double share = rules->number[OUTLIERS] * to->inlier + TOGETHER * (1.0 - to->inlier);
    double wide = S + rules->number[WIDTH] * r;
    /* An impossible error says nothing; nor does a step without a number. */
    if (!(fabs(e) < LARGEST_NOISE * sqrt(wide) && LARGEST_NOISE * wide < BEYOND * BEYOND)) {
        if (to->counts) at->weight[s] += log_one(SMALLEST);
        to->inlier = 1.0 / LARGEST_NOISE;
        return 0.0;
    }
    double inlier = (1.0 - share) * exp_one(-0.5 * e * e / S) / sqrt(S);
    double both = inlier + share * exp_one(-0.5 * e * e / wide) / sqrt(wide) + SMALLEST;
    if (to->counts) at->weight[s] += log_one(both);
    double kept = inlier / both;
    kept = kept > 1.0 / LARGEST_NOISE ? kept : 1.0 / LARGEST_NOISE;
    to->inlier = kept < to->inlier ? kept : to->inlier;
    S /= kept;
    for (int64_t i = 0; i < D; i++) {
        double gain = to->is_free[i] ? to->Pj[i] / S : 0.0;
        double moved = theta[i] + to->unit[i] * gain * e;
        if (i < d) {
            double variance = P[i * D + i] > SMALLEST ? P[i * D + i] : SMALLEST;
            to->taught[i] += gain * (2.0 * to->Pj[i] - S * gain) / variance;
            moved = moved < rules->low[i] ? rules->low[i] : moved;
            moved = moved > rules->high[i] ? rules->high[i] : moved;
        }
        theta[i] = moved;
        to->step[i] = gain;
    }
    for (int64_t i = 0; i < D; i++)
        for (int64_t k = 0; k <= i; k++) {
            double g = to->step[i], h = to->step[k];
            P[i * D + k] += S * (g * h) - g * to->Pj[k] - to->Pj[i] * h;
            P[k * D + i] = P[i * D + k];
        }
    return kept;
}

/* A step by output o, which is no state; returns the share of the inlier. */
static double step_by_output(const track_sizes *of, population *at, const rules_of *rules, desk *to,
                             int64_t o, int64_t s) {
    int64_t D = of->d + of->n;
    double e = to->y[o] - result_of(of, to, o, 0, s);
    for (int64_t i = 0; i < D; i++) {
        to->step[i] = result_of(of, to, o, 1 + i, s) * to->unit[i];
        e -= to->step[i] * ((at->theta[s * D + i] - to->before[i]) / to->unit[i]);
    }
    return step_by(of, at, rules, to, s, e, noise_of(of, rules, to, o, s, of->n));
}

/* A step by the measured state c at the end of the row; returns the share of the inlier. If the
   value is an outlier, either it or the prediction is wrong, so the state is half way between. */
static double step_by_state(const track_sizes *of, population *at, const rules_of *rules, desk *to,
                            int64_t c, int64_t s) {
    int64_t D = of->d + of->n, k = of->d + c;
    double r = rules->sigma[c] * rules->sigma[c], e = to->y[c] - at->theta[s * D + k];
    double half = 0.5 * e, most = 2.0 * sqrt(rules->number[WIDTH] * r);
    half = half > most ? most : half < -most ? -most : half;
    memset(to->step, 0, (size_t)D * sizeof(double));
    to->step[k] = to->unit[k];
    double kept = step_by(of, at, rules, to, s, e, r);
    at->theta[s * D + k] += (1.0 - kept) * half;
    at->P[(s * D + k) * D + k] += (1.0 - kept) * half * half / (to->unit[k] * to->unit[k]);
    return kept;
}

/* Move the states of hypothesis s to the end of the row. */
static void advance(const track_sizes *of, population *at, const rules_of *rules, desk *to,
                    int64_t s) {
    int64_t d = of->d, n = of->n, D = d + n;
    double *theta = at->theta + s * D, *P = at->P + s * D * D, *J = to->onward, *M = to->carried;
    /* The states, and their slopes in units of parameters and states. */
    for (int64_t c = 0; c < n; c++) {
        double after = result_of(of, to, c, 0, s);
        for (int64_t i = 0; i < D; i++) {
            double slope = result_of(of, to, c, 1 + i, s);
            after += slope * (theta[i] - to->before[i]);
            J[c * D + i] = slope * to->unit[i] / to->unit[d + c];
        }
        to->step[c] = after;
    }
    memcpy(theta + d, to->step, (size_t)n * sizeof(double));
    /* The covariance, and the error of the step. */
    for (int64_t c = 0; c < n; c++)
        for (int64_t i = 0; i < D; i++) {
            double sum = 0.0;
            for (int64_t k = 0; k < D; k++) sum += J[c * D + k] * P[k * D + i];
            M[c * D + i] = sum;
        }
    for (int64_t c = 0; c < n; c++) {
        for (int64_t i = 0; i < d; i++) P[(d + c) * D + i] = P[i * D + d + c] = M[c * D + i];
        for (int64_t b = 0; b <= c; b++) {
            double sum = 0.0;
            for (int64_t k = 0; k < D; k++) sum += M[c * D + k] * J[b * D + k];
            P[(d + c) * D + d + b] = P[(d + b) * D + d + c] = sum;
        }
        double more = noise_of(of, rules, to, c, s, n) - rules->sigma[c] * rules->sigma[c];
        double error = rules->number[STEP_ERROR];
        P[(d + c) * D + d + c] += error * error + more / (to->unit[d + c] * to->unit[d + c]);
    }
}

/* Weigh and improve a hypothesis by all outputs. */
static void learn(const track_sizes *of, population *at, const rules_of *rules, desk *to,
                  int64_t s, int is_best) {
    int64_t d = of->d, D = d + of->n, each = 1 + d + of->q;
    double information = 0.0;
    for (int64_t i = 0; i < D; i++) {
        to->before[i] = at->theta[s * D + i];
        to->is_free[i] = 1;
        if (i >= d) continue;
        int enough = information_of(of, rules, to, s, i) >= rules->number[USE] * at->peak[i];
        to->is_free[i] = enough || rules->watched[i] == 0.0;
        if (!enough) to->grown[s * d + i] = 0.0; /* drift is a belief while rows teach nothing */
        to->teaches[s] |= enough && rules->watched[i] > 0.0;
        to->taught[i] = 0.0;
    }
    for (int64_t k = 0; k < of->m * each; k++)
        if (k % each <= D && !isfinite(to->results[k * of->K + s])) {
            at->weight[s] += log_one(SMALLEST);
            for (int64_t c = 0; c < of->n; c++) set_state(of, at, s, c, at->measured[c], 1.0);
            return;
        }
    to->inlier = 1.0;
    for (int64_t o = of->n; o < of->m; o++) {
        double worth = is_best ? worth_of(of, at, rules, to, o, s) : 0.0;
        if (!isnan(to->y[o])) information += worth * step_by_output(of, at, rules, to, o, s);
    }
    advance(of, at, rules, to, s);
    for (int64_t c = 0; c < of->n; c++) {
        double worth = is_best ? worth_of(of, at, rules, to, c, s) : 0.0;
        if (isnan(to->y[c])) continue;
        double kept = step_by_state(of, at, rules, to, c, s);
        information += worth * kept;
        /* A state that an outlier began, at either end of the row, begins again. */
        if (is_best && kept < OVER) to->again |= to->began & 1ull << c;
    }
    for (int64_t i = 0; i < d; i++) {
        double *share = at->share + s * d + i;
        double taught = to->taught[i] > 0.0 ? to->taught[i] : 0.0;
        taught = taught < 1.0 ? taught : 1.0;
        *share *= (1.0 - to->grown[s * d + i]) * (1.0 - taught);
        *share += taught;
    }
    if (is_best) at->number[GAIN] = information;
}

/* Weigh and improve all hypotheses. Rows with wrong inputs may fit a change alone, so that no
   hypothesis gains more on the best one than a row can say. */
static void learn_all(const track_sizes *of, population *at, const rules_of *rules, desk *to,
                      int64_t best) {
    double old = at->weight[best];
    learn(of, at, rules, to, best, 1);
    double most = at->weight[best] - old - log_one(rules->number[WRONG]);
    for (int64_t s = 0; s < of->K; s++) {
        if (s == best || at->weight[s] <= EMPTY) continue;
        double limit = at->weight[s] + most;
        learn(of, at, rules, to, s, 0);
        if (at->weight[s] > limit) at->weight[s] = limit;
    }
}

static int64_t best_of(const track_sizes *of, const population *at) {
    int64_t best = 0;
    for (int64_t s = 1; s < of->K; s++)
        if (at->weight[s] > at->weight[best]) best = s;
    return best;
}

/* Whether a hypothesis was born after the last alarm and differs from the one it departed from. */
static int is_change(const track_sizes *of, const population *at, const rules_of *rules,
                     int64_t s) {
    if (!(at->born[s] > at->number[SINCE])) return 0;
    for (int64_t i = 0; i < of->d; i++) {
        double away = fabs(at->theta[s * (of->d + of->n) + i] - at->was[s * of->d + i]);
        if (rules->watched[i] > 0.0 && away > rules->number[NEAR] * rules->unit[i]) return 1;
    }
    return 0;
}

/* Weigh a change against none; returns the best hypothesis, and the best of no change. */
static int64_t judge(const track_sizes *of, population *at, const rules_of *rules,
                     int64_t *first) {
    int64_t best = best_of(of, at);
    double top = at->weight[best], changed = SMALLEST, same = SMALLEST;
    *first = -1;
    for (int64_t s = 0; s < of->K; s++) {
        if (at->weight[s] <= EMPTY) continue;
        double weight = at->weight[s] - top;
        at->weight[s] = weight > LEAST_WEIGHT ? weight : LEAST_WEIGHT;
        *(is_change(of, at, rules, s) ? &changed : &same) += exp_one(at->weight[s]);
        int early = !(at->born[s] > at->number[SINCE]);
        if (early && (*first < 0 || at->weight[s] > at->weight[*first])) *first = s;
    }
    if (*first < 0) *first = best;
    at->number[ODDS] = log_one(changed / same);
    if (at->number[CLOCK] < at->number[QUIET_UNTIL]) at->number[SINCE] = at->number[ROW];
    else if (at->number[ODDS] > rules->number[THRESHOLD]) {
        at->number[ALARM] = 1.0;
        at->number[QUIET_UNTIL] = at->number[CLOCK] + rules->number[HOLD];
    }
    return best;
}

/* Put a fresh hypothesis in the place of the least likely one: a copy of the best one with another
   memory, whose watched parameters jump or not. */
static void bear(const track_sizes *of, population *at, const rules_of *rules, int64_t best,
                 int64_t first, int jumps, double memory) {
    int64_t d = of->d, D = d + of->n, slot = -1;
    for (int64_t s = 0; s < of->K; s++) {
        int able = s != best && s != first;
        able = able && at->number[ROW] - at->born[s] > rules->number[EVERY];
        if (able && (slot < 0 || at->weight[s] < at->weight[slot])) slot = s;
    }
    if (slot < 0) return;
    size_t line = (size_t)d * sizeof(double), all = (size_t)D * sizeof(double);
    int own = at->born[best] <= at->number[SINCE];
    memcpy(at->was + slot * d, own ? at->theta + best * D : at->was + best * d, line);
    memcpy(at->theta + slot * D, at->theta + best * D, all);
    memcpy(at->P + slot * D * D, at->P + best * D * D, (size_t)D * all);
    for (int64_t i = 0; i < d; i++) {
        at->P[(slot * D + i) * D + i] += jumps && rules->watched[i] > 0.0 ? 1.0 : 0.0;
        at->share[slot * d + i] = 1.0;
    }
    if (jumps)
        for (int64_t c = 0; c < of->n; c++) set_state(of, at, slot, c, at->measured[c], 1.0);
    at->calm[slot] = memory;
    at->drift[slot] = memory + (jumps ? rules->number[BURST] : 0.0);
    at->born[slot] = at->number[ROW];
    at->weight[slot] = log_one(rules->number[jumps ? HAZARD : ONSET]);
}

/* A fresh hypothesis of a jump, and one of a drift that begins unless one as likely lives. Long and
   middle memory alternate after jumps. */
static void bear_both(const track_sizes *of, population *at, const rules_of *rules, int64_t best,
                      int64_t first) {
    const double *number = rules->number;
    double fresh = log_one(number[ONSET]);
    int due = at->calm[best] == number[LONG];
    for (int64_t s = 0; s < of->K; s++)
        due = due && !(at->drift[s] == number[MIDDLE] && at->weight[s] >= fresh);
    int odd = fmod(at->number[TURN], 2.0) == 1.0;
    bear(of, at, rules, best, first, 1, number[odd ? MIDDLE : LONG]);
    if (due) bear(of, at, rules, best, first, 0, number[MIDDLE]);
    at->number[TURN] += 1.0;
}

static void write_estimate(const track_sizes *of, const double *numbers, double *memory,
                           double *estimate) {
    rules_of rules = rules_in(of, numbers);
    population at = population_in(of, memory);
    int64_t K = of->K, d = of->d, D = d + of->n;
    double *to = estimate, total = 0.0;
    double *mean = next(&to, d), *covariance = next(&to, d * d), *weights = next(&to, K);
    double *means = next(&to, K * d), *deviations = next(&to, K * d);
    for (int64_t s = 0; s < K; s++) total += weights[s] = exp_one(at.weight[s]);
    memset(mean, 0, (size_t)(d + d * d) * sizeof(double));
    for (int64_t s = 0; s < K; s++) {
        weights[s] /= total;
        int is_long = at.drift[s] <= rules.number[LONG];
        for (int64_t i = 0; i < d; i++) {
            double variance = at.P[(s * D + i) * D + i];
            double share = is_long ? at.share[s * d + i] : 1.0;
            mean[i] += weights[s] * at.theta[s * D + i];
            deviations[s * d + i] = rules.unit[i] * sqrt(share);
            means[s * d + i] = variance > 0.0 ? sqrt(variance) : 0.0;
        }
        for (int64_t i = 0; i < d && weights[s] > 0.0; i++)
            for (int64_t l = 0; l < d; l++)
                covariance[i * d + l] += weights[s] * at.P[(s * D + i) * D + l] *
                    deviations[s * d + i] * deviations[s * d + l];
    }
    for (int64_t s = 0; s < K; s++) {
        for (int64_t i = 0; i < d && weights[s] > 0.0; i++)
            for (int64_t l = 0; l < d; l++)
                covariance[i * d + l] += weights[s] * (at.theta[s * D + i] - mean[i]) *
                    (at.theta[s * D + l] - mean[l]);
        for (int64_t i = 0; i < d; i++) {
            deviations[s * d + i] *= means[s * d + i];
            means[s * d + i] = at.theta[s * D + i];
        }
    }
    for (int64_t i = 0; i < d; i++) { /* a mean of bounds is rounded */
        mean[i] = mean[i] < rules.low[i] ? rules.low[i] : mean[i];
        mean[i] = mean[i] > rules.high[i] ? rules.high[i] : mean[i];
    }
}

int track_update(const track_sizes *of, const double *numbers, const double *row, double *memory,
                 double *estimate) {
    rules_of rules = rules_in(of, numbers);
    population at = population_in(of, memory);
    desk to;
    if (!open_desk(of, &rules, &to)) return 0;
    workspace *room = tape_open(of->tape, of->K);
    if (!room) { free(to.X); return 0; }
    double seconds = pass_time(&at, &rules, row[of->p + of->m]);
    select_usable(of, &at, &rules, row, &to);
    at.number[GAIN] = at.number[ALARM] = 0.0;
    let_drift(of, &at, &rules, seconds, &to);
    if (to.any) {
        int64_t before = best_of(of, &at);
        smooth_inputs(of, &at, &rules, row, seconds, &to);
        begin_states(of, &at, &rules, row, &to);
        memcpy(at.measured, to.y, (size_t)of->n * sizeof(double));
        run_tape(of, &at, room, &to);
        note(of, &at, &rules, &to, before);
        to.counts = counts(of, &at, &rules, &to, before);
        learn_all(of, &at, &rules, &to, before);
    } else {
        for (int64_t c = 0; c < of->n; c++) at.measured[c] = NOT_A_NUMBER;
    }
    int64_t first, best = judge(of, &at, &rules, &first);
    int due = fmod(at.number[ROW], rules.number[EVERY]) == 0.0;
    if (to.any && due && to.teaches[best]) bear_both(of, &at, &rules, best, first);
    for (int64_t c = 0; c < of->n; c++)
        if (to.again >> c & 1) at.measured[c] = NOT_A_NUMBER;
    at.number[ROW] += 1.0;
    write_estimate(of, numbers, memory, estimate);
    tape_close(room);
    free(to.X);
    return 1;
}
