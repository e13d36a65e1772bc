/* Mutation steps, see climb.h. */
#include <stdlib.h>
#include <string.h>
#include "climb.h"

static double between(double x, double low, double high) {
    double y = x < low ? low : x;
    return y > high ? high : y;
}

/* Mutant of row i in step k (Eq. 2); mutants of the first step are given. */
static void mutate(const climb *c, int64_t k, int64_t i, double *mutant) {
    if (!k) {
        memcpy(mutant, c->first + i * c->d, c->d * sizeof(double));
        return;
    }
    const double *parent = c->P + i * c->d, *sigma = c->sigma + (k - 1) * c->d;
    const double *noise = c->noise + ((k - 1) * c->n + i) * c->d;
    for (int64_t j = 0; j < c->d; j++)
        mutant[j] = between(noise[j] * sigma[j] + parent[j], c->low[j], c->high[j]);
}

/* Replace the parent by a better mutant, and list it if it is the best. */
static void accept(climb *c, int64_t i, double value, const double *mutant, int64_t evaluations,
                   climbed *done) {
    memcpy(c->P + i * c->d, mutant, c->d * sizeof(double));
    c->L[i] = value;
    if (!(value < c->best)) return;
    c->best = value;
    c->at[done->improvements] = evaluations;
    c->losses[done->improvements] = value;
    memcpy(c->thetas + done->improvements * c->d, mutant, c->d * sizeof(double));
    done->improvements++;
}

int climb_by_tape(const tape *t, const measurements *m, climb *c, climbed *done) {
    double *mutant = malloc((c->d + 1) * sizeof(double));
    workspace *w = tape_open(t, m->rows);
    int ready = mutant && w;
    memset(done, 0, sizeof *done);
    for (int64_t k = 0; ready && k <= c->more; k++) {
        for (int64_t i = 0; i < c->n; i++) {
            double limit = c->early_stopping ? c->L[i] : __builtin_inf();
            mutate(c, k, i, mutant);
            double value = tape_mean_square(t, mutant, m, limit, w);
            if (value < c->L[i]) accept(c, i, value, mutant, k * c->n + i + 1, done);
            else if (value != value) done->nans++;
            else if (value == __builtin_inf()) done->infinities++;
        }
        done->steps++;
        if (c->best <= c->target) break;
    }
    tape_close(w);
    free(mutant);
    return ready;
}
