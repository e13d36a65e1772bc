/* Operations of a tape on blocks of rows. Compiled once for each level, with name LEVEL. */
#include "large_angles.h"
#include "tape.h"
#include "columns.h"
#include "variations.h"

/* Operands and results of a block do not overlap, or are the same rows, so that rows can be
   computed side by side. */
#define EACH(value) \
    _Pragma("GCC ivdep") for (int i = 0; i < rows; i++) o[i] = (value); \
    break
#define CASE(name, value) case OP_##name: EACH(value)
#define PAIR(one, other, value) case OP_##one * COUNT_OF_OPERATIONS + OP_##other: EACH(value)

static int any_large(const double *a, int rows) {
    int any = 0;
    for (int i = 0; i < rows; i++) any |= !(size_of(a[i]) < SMALL_ANGLE);
    return any;
}

/* The three operations of an angle, for blocks with a large one. */
static void large_angles(int op, const double *a, double *o, double *o2, int rows) {
    for (int i = 0; i < rows; i++) {
        double cosine, sine = any_sine_cosine(a[i], &cosine);
        o[i] = op == OP_COS ? cosine : op == OP_TAN ? sine / cosine : sine;
        if (op == OP_SINCOS) o2[i] = cosine;
    }
}

static void angles(int op, const double *a, double *o, double *o2, int rows) {
    double c;
    if (any_large(a, rows)) {
        large_angles(op, a, o, o2, rows);
        return;
    }
    switch (op) {
    CASE(SIN, small_sine_cosine(a[i], &c));
    CASE(COS, (small_sine_cosine(a[i], &c), c));
    case OP_TAN:
        _Pragma("GCC ivdep") for (int i = 0; i < rows; i++) {
            double cosine, sine = small_sine_cosine(a[i], &cosine);
            o[i] = sine / cosine;
        }
        break;
    case OP_SINCOS:
        _Pragma("GCC ivdep") for (int i = 0; i < rows; i++) {
            double cosine, sine = small_sine_cosine(a[i], &cosine);
            o[i] = sine;
            o2[i] = cosine;
        }
    }
}

static void log_parts_of(const double *a, double *o, double *o2, int rows) {
    _Pragma("GCC ivdep") for (int i = 0; i < rows; i++) {
        double rest, L = log_parts(a[i], &rest);
        o[i] = L;
        o2[i] = rest;
    }
}

static void floor_parts_of(const double *a, const double *b, double *o, double *o2, int rows) {
    _Pragma("GCC ivdep") for (int i = 0; i < rows; i++) {
        double rest, L = floor_parts(a[i], b[i], &rest);
        o[i] = L;
        o2[i] = rest;
    }
}

INLINE void functions(int op, const double *a, const double *b, double *o, int rows) {
    switch (op) {
    CASE(EXP, exp_of(a[i]));
    CASE(EXPM1, expm1_of(a[i]));
    CASE(LOG, log_of(a[i]));
    CASE(LOG1P, log1p_of(a[i]));
    CASE(LOG10, log10_of(a[i]));
    CASE(LOG2, log2_of(a[i]));
    CASE(ASIN, asin_of(a[i]));
    CASE(ACOS, acos_of(a[i]));
    CASE(ATAN, atan_of(a[i]));
    CASE(ATAN2, atan2_of(a[i], b[i]));
    CASE(HYPOT, hypot_of(a[i], b[i]));
    CASE(SINH, sinh_of(a[i]));
    CASE(COSH, cosh_of(a[i]));
    CASE(TANH, tanh_of(a[i]));
    CASE(ASINH, asinh_of(a[i]));
    CASE(ACOSH, acosh_of(a[i]));
    CASE(ATANH, atanh_of(a[i]));
    }
}

INLINE void conditions(int op, const double *a, const double *b, double *o, int rows) {
    switch (op) {
    CASE(GT, a[i] > b[i] ? 1.0 : 0.0);
    CASE(GE, a[i] >= b[i] ? 1.0 : 0.0);
    CASE(LT, a[i] < b[i] ? 1.0 : 0.0);
    CASE(LE, a[i] <= b[i] ? 1.0 : 0.0);
    CASE(EQ, a[i] == b[i] ? 1.0 : 0.0);
    CASE(NE, a[i] != b[i] ? 1.0 : 0.0);
    CASE(AND, a[i] * b[i]);
    CASE(OR, a[i] + b[i] - a[i] * b[i]);
    CASE(NOT, 1.0 - a[i]);
    }
}

/* One instruction; the second operand of some is a scalar. */
INLINE void operate(const instruction *q, double *const *r, const double *scalars, int rows) {
    int scalar = q->op >= OP_ADD_S && q->op <= OP_S_DIV;
    double s = scalar ? scalars[q->operand[1]] : 0.0;
    const double *a = r[q->operand[0]], *b = r[scalar ? 0 : q->operand[1]];
    double *o = r[q->result[0]];
    switch (q->op) {
    CASE(ADD, a[i] + b[i]);
    CASE(SUB, a[i] - b[i]);
    CASE(MUL, a[i] * b[i]);
    CASE(DIV, a[i] / b[i]);
    CASE(ADD_S, a[i] + s);
    CASE(MUL_S, a[i] * s);
    CASE(SUB_S, a[i] - s);
    CASE(DIV_S, a[i] / s);
    CASE(S_SUB, s - a[i]);
    CASE(S_DIV, s / a[i]);
    CASE(NEG, -a[i]);
    CASE(SQUARE, a[i] * a[i]);
    CASE(SQRT, __builtin_sqrt(a[i]));
    CASE(ABS, size_of(a[i]));
    CASE(SIGN, sign_of(a[i]));
    CASE(COPY, a[i]);
    CASE(MIN, least(a[i], b[i]));
    CASE(MAX, largest(a[i], b[i]));
    CASE(BOUND, a[i] < -1e300 ? -1e300 : a[i] > 1e300 ? 1e300 : a[i]);
    case OP_WHERE: {
        const double *c = r[q->operand[2]];
        EACH(a[i] != 0.0 ? b[i] : c[i]);
    }
    case OP_POWER: {
        const double *c = r[q->operand[2]], *d = r[q->operand[3]];
        EACH(power_of(a[i], b[i], c[i], d[i]));
    }
    case OP_SIN: case OP_COS: case OP_SINCOS: case OP_TAN:
        angles(q->op, a, o, r[q->result[1]], rows);
        break;
    case OP_LOG_PARTS:
        log_parts_of(a, o, r[q->result[1]], rows);
        break;
    case OP_FLOOR_PARTS:
        floor_parts_of(a, b, o, r[q->result[1]], rows);
        break;
    default:
        if (q->op >= OP_GT) conditions(q->op, a, b, o, rows);
        else functions(q->op, a, b, o, rows);
    }
}

/* Combine two instructions with scalars, the second of which overwrites the result of the first, in
   one pass over the rows. Returns whether this was possible. */
INLINE int operate_two(const instruction *q, double *const *r, const double *scalars, int rows) {
    if (q[1].op < OP_ADD_S || q[1].op > OP_S_DIV || q[1].operand[0] != q[0].result[0] ||
        q[1].result[0] != q[0].result[0]) return 0;
    const double *a = r[q[0].operand[0]];
    double *o = r[q[0].result[0]], s = scalars[q[0].operand[1]], t = scalars[q[1].operand[1]];
    switch (q[0].op * COUNT_OF_OPERATIONS + q[1].op) {
    PAIR(ADD_S, MUL_S, (a[i] + s) * t);
    PAIR(SUB_S, MUL_S, (a[i] - s) * t);
    PAIR(S_SUB, MUL_S, (s - a[i]) * t);
    PAIR(MUL_S, ADD_S, a[i] * s + t);
    PAIR(MUL_S, SUB_S, a[i] * s - t);
    PAIR(MUL_S, S_SUB, t - a[i] * s);
    default: return 0;
    }
    return 1;
}

static void run(const instruction *from, const instruction *to, double *const *registers,
                const double *scalars, int rows) {
    if (rows == 1) /* a constant 1 removes the loop */
        for (const instruction *q = from; q < to; q++) operate(q, registers, scalars, 1);
    else
        for (const instruction *q = from; q < to; q++) {
            int scalar = q->op >= OP_ADD_S && q->op <= OP_S_DIV && q + 1 < to;
            if (scalar && operate_two(q, registers, scalars, rows)) q++;
            else operate(q, registers, scalars, rows);
        }
}

/* Sum of (values - data)^2 in eight lanes, then in pairs, the same on every processor. */
static double square_sum(const double *values, const double *data, int rows) {
    double sums[8] = {0};
    int i = 0;
    for (; i + 8 <= rows; i += 8)
        for (int k = 0; k < 8; k++) {
            double r = values[i + k] - data[i + k];
            sums[k] += r * r;
        }
    for (int k = 0; i + k < rows; k++) {
        double r = values[i + k] - data[i + k];
        sums[k] += r * r;
    }
    return in_pairs(sums);
}

#define JOINED(a, b) a##b
#define NAMED(a, b) JOINED(a, b)
#define QUOTED(a) #a
#define TEXT(a) QUOTED(a)
const level NAMED(level_, LEVEL) = {
    TEXT(LEVEL), run, square_sum, product_sum, fold, update_columns, vary, vary_step,
};
