/* Operations of a tape on blocks of rows, with registers of WIDTH doubles. Compiled once for each
   level, and for one row. */
#include "elementary.h"
#include "tape.h"
#include "functions.h"

#define EACH(value) \
    EVERY_ROW o[i] = (value); \
    break
#define CASE(name, value) case OP_##name: EACH(value)
#define PAIR(one, other, value) case OP_##one * COUNT_OF_OPERATIONS + OP_##other: EACH(value)

INLINE void functions(int op, const double *a, const double *b, double *o, int rows) {
    switch (op) {
    case OP_EXP: exp_of_rows(a, o, rows); break;
    case OP_EXPM1: expm1_of_rows(a, o, rows); break;
    case OP_LOG: log_of_rows(a, o, rows); break;
    case OP_LOG1P: log1p_of_rows(a, o, rows); break;
    case OP_ATAN: atan_of_rows(a, o, rows); break;
    CASE(HYPOT, hypot_of(a[i], b[i]));
    case OP_LOG10: case OP_LOG2: logarithms(op, a, o, rows); break;
    case OP_ASIN: case OP_ACOS: case OP_ATAN2: inverse_angles(op, a, b, o, rows); break;
    case OP_SINH: case OP_COSH: case OP_TANH: hyperbolic(op, a, o, rows); break;
    default: inverse_hyperbolic(op, a, o, rows);
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
