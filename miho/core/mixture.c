/* Intervals of a mixture of normal distributions, see track.h. */
#include <math.h>
#include "elementary.h"
#include "track.h"

#define SMALLEST 1e-300
#define NEGLIGIBLE 1e-6        /* weight in an interval */
#define FAR 40.0               /* deviations that hold all of a distribution */
#define CLOSE 1e-6
#define ROOT_PI 1.7724538509055159
#define MOST_STEPS 60

/* Probability between -x and x of a normal distribution of variance 1/2, to 1.5e-7 (Abramowitz and
   Stegun, Handbook of Mathematical Functions, 7.1.26). */
static double erf_of(double x) {
    double t = 1.0 / (1.0 + 0.3275911 * fabs(x));
    double sum = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 +
                 t * 1.061405429))));
    return with_sign(1.0 - sum * exp_one(-x * x), x);
}

/* Probability within x of the centre of number i, of all weights that count, and its derivative. */
static double probability_within(const mixture *of, double centre, double x, int64_t i,
                                 double *density) {
    double sum = 0.0, slope = 0.0, total = 0.0;
    for (int64_t s = 0; s < of->n; s++) {
        if (!(of->weights[s] > NEGLIGIBLE)) continue;
        double away = of->means[s * of->d + i] - centre;
        double width = of->deviations[s * of->d + i] * 1.4142135623730951;
        width = width > SMALLEST ? width : SMALLEST;
        double a = (x - away) / width, b = (x + away) / width;
        total += of->weights[s];
        sum += of->weights[s] * 0.5 * (erf_of(a) + erf_of(b));
        slope += of->weights[s] * (exp_one(-a * a) + exp_one(-b * b)) / (width * ROOT_PI);
    }
    *density = slope / total;
    return sum / total;
}

/* Newton steps within a bracket, which halves where they leave it. */
static double reach_of(const mixture *of, double centre, double probability, int64_t i) {
    double low = 0.0, high = 0.0, spread = 0.0, density;
    for (int64_t s = 0; s < of->n; s++) {
        double away = fabs(of->means[s * of->d + i] - centre);
        double deviation = of->deviations[s * of->d + i], far = away + FAR * deviation;
        if (!(of->weights[s] > NEGLIGIBLE)) continue;
        if (far > high) high = far;
        spread += of->weights[s] * (away + 2.0 * deviation);
    }
    double x = spread < high ? spread : 0.5 * high;
    for (int k = 0; k < MOST_STEPS && high - low > CLOSE * high; k++) {
        double excess = probability_within(of, centre, x, i, &density) - probability;
        *(excess >= 0.0 ? &high : &low) = x;
        double to = x - excess / density;
        if (fabs(to - x) <= CLOSE * x) return to;
        x = to > low && to < high ? to : 0.5 * (low + high);
    }
    return x;
}

void mixture_reach(const mixture *of, const double *centre, double probability, double *out) {
    for (int64_t i = 0; i < of->d; i++) out[i] = reach_of(of, centre[i], probability, i);
}
