/* Phases of a bracket: which candidates continue, and on how many rows. Python form:
   miho/compiled/gauss_newton_bracket.py. */
#include <math.h>
#include <string.h>
#include "search.h"

/* A candidate is at a known minimum within this squared distance, in shares of its sum of squares
   and units of d / rows: the first value is 3 standard deviations. On all rows it is at most the
   second value, a share alone. */
#define NEAR 9.0
#define NEAR_LAST 0.1
/* But not if its loss is lower by more than this number of d / rows. */
#define BETTER 4.0
#define ENTERING 1e-3   /* largest at the start of a level, if it was done */
#define POLISHING 50    /* steps of the final descent, at most */
#define UNLIMITED ((int64_t)1 << 40)

static int on_all_rows(const search *s) { return s->place[AT_LEVEL] == s->p.levels - 1; }
static int64_t rows_of_level(const search *s) { return s->p.level_rows[s->place[AT_LEVEL]]; }

static double *numbers_at(const search *s, int64_t i) {
    return s->numbers + i * (4 * s->p.d + NUMBERS + s->p.levels);
}

static double loss_at(const search *s, int64_t i) {
    return ((candidate_numbers *)(numbers_at(s, i) + 4 * s->p.d))->loss;
}

candidate candidate_at(const search *s, int64_t i) {
    int64_t d = s->p.d, m = s->place[STORED];
    double *row = numbers_at(s, i);
    return (candidate){
        .x = row, .trial = row + d, .q = row + 2 * d, .D = row + 3 * d,
        .sums = row + 4 * d + NUMBERS,
        .R = s->R + i * d * d,
        .derivatives = m ? s->stored + i * (d + 1) * m : NULL,
        .is = (candidate_numbers *)(row + 4 * d),
        .has = (candidate_counts *)(s->counts + i * COUNTS),
    };
}

int64_t room_beside_residuals(int64_t d, int64_t levels) {
    int64_t side = d + 1;
    return levels + 7 * d + 2 * side * side + 7 + side * whole(2 * d) + (2 * d + 1) * CHUNK;
}

void divide_room(search *s, double *room, int64_t size) {
    int64_t d = s->p.d, side = d + 1;
    work_room *w = &s->w;
    double **const vectors[] = {
        &w->theta, &w->step, &w->low, &w->high, &w->scale, &w->solver.free, &w->solver.solution,
    };
    w->residual_room = size - room_beside_residuals(d, s->p.levels);
    w->solver.d = d;
    w->solver.level = s->p.sums;
    for (int k = 0; k < 7; k++, room += d) *vectors[k] = room;
    w->sums = room;
    w->T = w->sums + s->p.levels;
    w->solver.T = w->T + side * side;
    w->solver.columns = aligned(w->solver.T + side * side);
    w->chunk = w->solver.columns + side * whole(2 * d);
    w->slopes = w->chunk + side * CHUNK;
    w->residuals = w->slopes + d * CHUNK;
}

/* Set the rules for the candidates of this phase. */
static void set_rules(search *s) {
    const search_settings *from = &s->settings;
    int64_t phase = s->place[PHASE];
    int last = on_all_rows(s), polishes = phase == POLISH;
    s->m = rows_of_level(s);
    double share = (double)s->p.d / (double)s->m; /* of a loss; a smaller change is noise */
    double patience = from->patience * (double)(s->p.d + 1) * (double)s->m;
    double tolerance = polishes ? from->digits : from->tolerance;
    int alone = phase == LEAD || phase == FINISH || phase == REVIVE;
    s->rules = (step_rules){
        .level = s->place[AT_LEVEL], .last = last, .reach = from->reach, .secants = from->secants,
        .steps = phase == SCREEN ? 0 : phase == RUNG ? from->steps
            : phase == LEAD ? from->lead - from->steps : polishes ? POLISHING : UNLIMITED,
        .tolerance = last ? tolerance : from->level_tolerance * share,
        .patience = !alone ? 0 : patience < 0x1p62 ? (int64_t)patience : INT64_MAX,
        .allowance = phase == REVIVE ? from->allowance : 0,
        .progress = from->progress,
        .near = last ? smaller(NEAR * share, NEAR_LAST) : NEAR * share,
        .better = last ? 0.0 : BETTER * share,
        .ending = !polishes,
        .rounding = polishes ? 0.0 : from->rounding,
    };
}

/* Swap two arrays. */
static void swap(void *a, void *b, size_t size) {
    unsigned char *x = a, *y = b, room[256];
    for (size_t k = 0; k < size; k += sizeof room) {
        size_t part = size - k < sizeof room ? size - k : sizeof room;
        memcpy(room, x + k, part);
        memcpy(x + k, y + k, part);
        memcpy(y + k, room, part);
    }
}

/* Keep the candidates at the first `count` positions of `order`, and move the `first` of them to the
   front, in this order. */
static void keep_first(search *s, int64_t count, int64_t first) {
    size_t number = sizeof(double), d = (size_t)s->p.d, m = (size_t)s->place[STORED];
    for (int64_t k = 0; k < first; k++) {
        int64_t i = s->order[k];
        while (i < k) i = s->order[i]; /* the candidate there has moved since */
        if (i == k) continue;
        candidate a = candidate_at(s, i), b = candidate_at(s, k);
        swap(a.x, b.x, (4 * d + NUMBERS + (size_t)s->p.levels) * number);
        swap(a.has, b.has, sizeof *a.has);
        swap(a.R, b.R, d * d * number);
        if (m) swap(a.derivatives, b.derivatives, (d + 1) * m * number);
    }
    s->place[SIZE] = count;
}

static void keep(search *s, int64_t count) { keep_first(s, count, count); }

/* Number of candidates out of `size` that may make the steps of a rung. */
static int64_t largest_rung(const search *s, int64_t size) {
    return size / s->settings.eta > 1 ? size / s->settings.eta : 1;
}

/* Keep the candidates with finite losses, the best first; of those that were just drawn, only the
   ones that may continue are moved. */
static void sort_usable(search *s) {
    int64_t count = 0;
    for (int64_t i = 0; i < s->place[SIZE]; i++) {
        candidate c = candidate_at(s, i);
        if (c.has->stage == UNUSABLE || !isfinite(c.is->loss)) continue;
        int64_t k = count++;
        for (; k && loss_at(s, s->order[k - 1]) > c.is->loss; k--)
            s->order[k] = s->order[k - 1];
        s->order[k] = i;
    }
    int drawn = s->place[PHASE] == SCREEN && !s->settings.solved && count;
    keep_first(s, count, drawn ? largest_rung(s, count) : count);
}

/* Begin a phase; steps and progress are counted from here. */
static void begin(search *s, int64_t phase, int64_t active) {
    s->place[PHASE] = phase;
    s->place[ACTIVE] = active;
    for (int64_t i = 0; i < active; i++) {
        candidate c = candidate_at(s, i);
        c.has->trials = c.has->spent = c.has->spent_at_mark = 0;
        c.is->loss_at_mark = c.is->loss;
    }
}

/* Store derivatives on this level, if there is room and they may be updated. */
static void make_room(search *s) {
    int64_t m = rows_of_level(s), size = s->place[SIZE], projecting = 0;
    for (int64_t i = 0; i < size; i++) projecting += candidate_at(s, i).has->projects != 0;
    double numbers = (double)size * (double)(s->p.d + 1) * (double)m;
    int stores = numbers <= (double)s->settings.room && numbers <= (double)s->stored_room &&
        m <= s->w.residual_room && !(s->settings.compiled && projecting == size);
    s->place[STORED] = stores ? m : 0;
}

/* Mark the candidates for an evaluation of residuals and derivatives at the same place. */
static void look_again(search *s) {
    for (int64_t i = 0; i < s->place[SIZE]; i++) {
        candidate c = candidate_at(s, i);
        c.is->loss = c.is->predicted_gain = INFINITY;
        c.is->growth = 2.0;
        c.has->stage = ENTER;
        c.has->secants = 0;
        copy(c.x, c.trial, s->p.d);
    }
    s->place[ACTIVE] = s->place[SIZE];
    make_room(s);
}

/* Mark the candidates for an evaluation on the rows of the next level. */
static void enter(search *s) {
    const search_settings *from = &s->settings;
    for (int64_t i = 0; i < s->place[SIZE]; i++) {
        candidate c = candidate_at(s, i);
        int done = c.has->stage == DONE;
        c.has->projects = from->projects && (from->solved || !done || !on_all_rows(s));
        if (done) c.is->damping = smaller(c.is->damping, ENTERING);
    }
    look_again(s);
}

/* Give the best candidates their steps on this level; a single one has no limit. */
static int begin_rung(search *s, int entering) {
    const search_settings *from = &s->settings;
    int64_t size = s->place[SIZE];
    if (!size) {
        s->place[PHASE] = EMPTY;
        return 0;
    }
    /* A step costs derivatives and one evaluation. */
    double rows = (double)rows_of_level(s), all = (double)s->p.level_rows[s->p.levels - 1];
    double solved = from->projects ? (double)s->p.linears : 0.0;
    double cost = rows / all * (1.0 + solved) + (double)from->slope_cost * rows / all;
    double affordable = from->rung_budget / ((double)from->steps * cost);
    int64_t fewer = largest_rung(s, size);
    if (affordable < (double)fewer) fewer = affordable > 1.0 ? (int64_t)affordable : 1;
    s->place[SIZE] = fewer;
    if (entering) enter(s);
    begin(s, on_all_rows(s) && fewer == 1 ? FINISH : RUNG, fewer);
    return 1;
}

/* Drop copies of better candidates. */
static void drop_copies(search *s) {
    int64_t count = 0;
    for (int64_t j = 0; j < s->place[SIZE]; j++) {
        candidate c = candidate_at(s, j);
        int new = 1;
        for (int64_t k = 0; new && k < count; k++) {
            candidate better = candidate_at(s, s->order[k]);
            new = !is_copy(s, &better, &c);
        }
        if (new) s->order[count++] = j;
    }
    keep(s, count);
}

/* Continue on more rows with the candidates that may lead to a new minimum. */
static int prune(search *s) {
    int64_t level = s->place[AT_LEVEL], size = s->place[SIZE], count = 0;
    double least = INFINITY;
    for (int64_t k = 0; k < s->minima.count; k++) {
        double sum = s->minima.sums[k * s->p.levels + level];
        least = smaller(least, sum / (double)rows_of_level(s));
    }
    for (int64_t i = 0; i < size; i++) {
        candidate c = candidate_at(s, i);
        if (c.has->stage != AT_KNOWN && !(c.has->stage == DONE && c.is->loss >= least))
            s->order[count++] = i;
    }
    if (!count) {
        s->place[PHASE] = size ? RETURNED : EMPTY;
        return 0;
    }
    keep(s, count);
    drop_copies(s);
    int entering = !on_all_rows(s);
    s->place[AT_LEVEL] += entering;
    return begin_rung(s, entering);
}

/* Begin the next phase after the steps of one; 0 if the bracket has ended, because its last
   candidate has come to its end, or no candidate can lead to a new minimum. */
static int next_phase(search *s) {
    int64_t phase = s->place[PHASE];
    int last = on_all_rows(s);
    if (phase > LEAD) return 0;
    sort_usable(s);
    /* A problem that is linear in all parameters is solved: evaluate more rows. */
    if (phase == SCREEN && s->settings.solved) {
        if (!s->place[SIZE] || last) {
            s->place[PHASE] = s->place[SIZE] ? SOLVED : EMPTY;
            return 0;
        }
        s->place[AT_LEVEL]++;
        enter(s);
        return 1;
    }
    if (phase == SCREEN) return begin_rung(s, 0);
    /* The best candidate of a rung makes more steps, while the others wait. */
    if (phase == RUNG && s->place[SIZE] && !last) {
        begin(s, LEAD, 1);
        return 1;
    }
    return prune(s);
}

int run_bracket(search *s) {
    do {
        set_rules(s);
        /* All remaining starts descend to the end of the phase; then the best continue. */
        for (int64_t i = 0; i < s->place[ACTIVE]; i++) {
            int state = descend(s, i);
            if (state != FINISHED) return state;
        }
    } while (next_phase(s));
    return FINISHED;
}
