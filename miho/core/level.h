/* The functions of a level. Compiled once for each, with name LEVEL. */
#include "operations.h"
#include "columns.h"
#include "variations.h"

static void run(const instruction *from, const instruction *to, double *const *registers,
                const double *scalars, int rows) {
    if (rows == 1) {
        run_one_row(from, to, registers, scalars);
        return;
    }
    for (const instruction *q = from; q < to; q++) {
        int scalar = q->op >= OP_ADD_S && q->op <= OP_S_DIV && q + 1 < to;
        if (scalar && operate_two(q, registers, scalars, rows)) q++;
        else operate(q, registers, scalars, rows);
    }
}

/* Sum of (values - data)^2 in eight lanes, then in pairs, the same on every processor. */
static double square_sum(const double *values, const double *data, int rows) {
    wide sums[WIDES] = {0};
    int i = 0;
    for (; i + 8 <= rows; i += 8)
        EACH_WIDE {
            wide r = AT(values) - AT(data);
            sums[k] += r * r;
        }
    double each[8];
    numbers_of(sums, each);
    for (int k = 0; i + k < rows; k++) {
        double r = values[i + k] - data[i + k];
        each[k] += r * r;
    }
    return in_pairs(each);
}

#define JOINED(a, b) a##b
#define NAMED(a, b) JOINED(a, b)
#define QUOTED(a) #a
#define TEXT(a) QUOTED(a)
const level NAMED(level_, LEVEL) = {
    TEXT(LEVEL), run, square_sum, product_sum, fold, update_columns, vary, vary_step,
};
