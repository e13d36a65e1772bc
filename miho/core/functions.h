/* Functions on blocks of rows, for operations.h. One in steps reuses the loops of others. */

/* Operands and results of a block do not overlap, or are the same rows, so that rows can be
   computed side by side. Loops run over whole registers: more numbers than rows are computed, and
   no loop over a rest is compiled. */
#define WHOLE ((rows + WIDTH - 1) & -WIDTH)
#if WIDTH == 1
#define EVERY_ROW for (int i = 0; i < 1; i++)
#else
#define EVERY_ROW EACH_ROW for (int i = 0; i < WHOLE; i++)
#endif
/* Room for numbers of a function in steps. There is a row: else compilers warn. */
#define ROOM(...) double __VA_ARGS__; if (WHOLE < 1) __builtin_unreachable()
/* One loop for all that use it. */
#define SHARED static __attribute__((noinline)) void

/* Whether a number is at least as large as a limit, or NaN. */
static __attribute__((noinline)) int any_beyond(double limit, const double *a, int rows) {
    uint64_t small = SIGN_BIT; /* the sign of a difference */
    int rest = rows & -WIDTH;
    _Pragma("omp simd reduction(&: small)") for (int i = 0; i < rest; i++)
        small &= bits_of(size_of(a[i])) - bits_of(limit);
    for (int i = rest; i < rows; i++) small &= bits_of(size_of(a[i])) - bits_of(limit);
    return !small;
}

/* The operations of an angle, for blocks with a large one. */
SHARED large_angles(int op, const double *a, double *o, double *o2, int rows) {
    for (int i = 0; i < rows; i++) {
        double cosine, sine = sine_cosine_one(a[i], &cosine);
        o[i] = op == OP_COS ? cosine : op == OP_TAN ? sine / cosine : sine;
        if (op == OP_SINCOS) o2[i] = cosine;
    }
}

SHARED angles(int op, const double *a, double *o, double *o2, int rows) {
    if (WIDTH == 1 || any_beyond(SMALL_ANGLE, a, rows)) {
        large_angles(op, a, o, o2, rows);
        return;
    }
    switch (op) {
    case OP_SIN:
        EVERY_ROW { double cosine; o[i] = small_sine_cosine(a[i], &cosine); }
        break;
    case OP_COS:
        EVERY_ROW { double cosine; small_sine_cosine(a[i], &cosine); o[i] = cosine; }
        break;
    case OP_TAN:
        EVERY_ROW { double cosine, sine = small_sine_cosine(a[i], &cosine); o[i] = sine / cosine; }
        break;
    case OP_SINCOS:
        EVERY_ROW {
            double cosine;
            o[i] = small_sine_cosine(a[i], &cosine);
            o2[i] = cosine;
        }
    }
}

SHARED log_parts_of(const double *a, double *o, double *o2, int rows) {
    EVERY_ROW {
        double rest;
        o[i] = log_parts(a[i], &rest);
        o2[i] = rest;
    }
}

INLINE void floor_parts_of(const double *a, const double *b, double *o, double *o2, int rows) {
    EVERY_ROW {
        double rest;
        o[i] = floor_parts(a[i], b[i], &rest);
        o2[i] = rest;
    }
}

#define LOOP(name, value) \
    SHARED name##_of_rows(const double *a, double *o, int rows) { EVERY_ROW o[i] = (value); }
LOOP(exp, exp_of(a[i]))
LOOP(expm1, expm1_of(a[i]))
LOOP(half_exp, half_exp(a[i]))
LOOP(log, log_of(a[i]))
LOOP(log1p, log1p_of(a[i]))
LOOP(atan, atan_of(a[i]))
SHARED angles_of_rows(const double *rise, const double *run, double *o, int rows) {
    EVERY_ROW o[i] = atan_of_ratio(rise[i], run[i]);
}

/* LOG10 or LOG2. */
SHARED logarithms(int op, const double *a, double *o, int rows) {
    ROOM(k[MOST_ROWS], L[MOST_ROWS], rest[MOST_ROWS]);
    if (op == OP_LOG10) {
        log_parts_of(a, L, rest, rows);
        EVERY_ROW o[i] = log10_from(a[i], L[i], rest[i]);
    } else {
        EVERY_ROW { double power; L[i] = split(a[i], &power); k[i] = power; }
        log_parts_of(L, L, rest, rows);
        EVERY_ROW o[i] = log2_from(a[i], k[i], L[i], rest[i]);
    }
}

/* ASIN, ACOS or ATAN2. */
SHARED inverse_angles(int op, const double *a, const double *b, double *o, int rows) {
    ROOM(rise[MOST_ROWS], run[MOST_ROWS], angle[MOST_ROWS]);
    switch (op) {
    case OP_ASIN:
        EVERY_ROW run[i] = other_side(rise[i] = size_of(a[i]));
        break;
    case OP_ACOS:
        EVERY_ROW rise[i] = other_side(run[i] = size_of(a[i]));
        break;
    default:
        EVERY_ROW {
            double scale = atan2_scale(a[i], b[i]);
            rise[i] = size_of(a[i]) * scale;
            run[i] = size_of(b[i]) * scale;
        }
    }
    angles_of_rows(rise, run, angle, rows);
    switch (op) {
    case OP_ASIN: EVERY_ROW o[i] = asin_from(a[i], angle[i]); break;
    case OP_ACOS: EVERY_ROW o[i] = acos_from(a[i], rise[i], angle[i]); break;
    default: EVERY_ROW o[i] = atan2_from(a[i], b[i], angle[i]);
    }
}

/* COSH, TANH or SINH. */
SHARED hyperbolic(int op, const double *a, double *o, int rows) {
    ROOM(y[MOST_ROWS], large[MOST_ROWS]);
    switch (op) {
    case OP_COSH:
        half_exp_of_rows(a, y, rows);
        EVERY_ROW o[i] = y[i] + 0.25 / y[i];
        break;
    case OP_TANH:
        EVERY_ROW y[i] = tanh_inner(a[i]);
        expm1_of_rows(y, y, rows);
        EVERY_ROW o[i] = tanh_from(a[i], y[i]);
        break;
    case OP_SINH:
        EVERY_ROW y[i] = sinh_inner(a[i]);
        expm1_of_rows(y, y, rows);
        if (!any_beyond(22.0, a, rows)) {
            EVERY_ROW o[i] = sinh_from(a[i], y[i]);
            break;
        }
        half_exp_of_rows(a, large, rows);
        EVERY_ROW {
            double exact = sinh_from(a[i], y[i]);
            o[i] = size_of(a[i]) > 22.0 ? with_sign(large[i], a[i]) : exact;
        }
    }
}

/* ASINH, ACOSH or ATANH. */
SHARED inverse_hyperbolic(int op, const double *a, double *o, int rows) {
    ROOM(y[MOST_ROWS], large[MOST_ROWS]);
    switch (op) {
    case OP_ASINH: EVERY_ROW y[i] = asinh_inner(a[i]); break;
    case OP_ACOSH: EVERY_ROW y[i] = acosh_inner(a[i]); break;
    default: EVERY_ROW y[i] = atanh_inner(a[i]);
    }
    log1p_of_rows(y, y, rows);
    if (op == OP_ATANH) {
        EVERY_ROW o[i] = atanh_from(a[i], y[i]);
        return;
    }
    if (any_beyond(0x1p28, a, rows)) { /* log(2 x) */
        EVERY_ROW large[i] = size_of(a[i]);
        log_of_rows(large, large, rows);
        EVERY_ROW y[i] = size_of(a[i]) > 0x1p28 ? large[i] + (LN2_0 + LN2_1) : y[i];
    }
    if (op == OP_ASINH) EVERY_ROW o[i] = asinh_from(a[i], y[i]);
    else EVERY_ROW o[i] = acosh_from(a[i], y[i]);
}
