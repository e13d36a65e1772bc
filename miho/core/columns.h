/* Sums over columns of rows. Compiled once for each level, by level.h. */

#define SMALLEST 0x1p-1022      /* the smallest normal number */

/* Eight sums in pairs: with every eighth term in each, the same bits whatever the processor. */
static double in_pairs(const double *sums) {
    double even = (sums[0] + sums[4]) + (sums[2] + sums[6]);
    return even + ((sums[1] + sums[5]) + (sums[3] + sums[7]));
}

/* As many numbers as a register of this level has, and their sums in pairs. The functions with them
   are for whole eights of rows. */
typedef double wide __attribute__((vector_size(8 * WIDTH), aligned(8), may_alias));
#define WIDES (8 / WIDTH)
#define UNROLLED _Pragma("GCC unroll 8")
#define EACH_WIDE UNROLLED for (int k = 0; k < WIDES; k++)
#define AT(a) ((const wide *)((a) + i))[k]

INLINE void numbers_of(const wide *sums, double *each) {
    UNROLLED for (int k = 0; k < 8; k++) each[k] = sums[k / WIDTH][k % WIDTH];
}

INLINE double wide_in_pairs(const wide *sums) {
    double each[8];
    numbers_of(sums, each);
    return in_pairs(each);
}

/* Product sums of the first of n columns and each of them. */
static void product_sums(double *columns, int64_t stride, int64_t rows, int64_t n, double *out) {
    for (int64_t j = 0; j < n; j++) {
        wide sums[WIDES] = {0};
        for (int64_t i = 0; i < rows; i += 8)
            EACH_WIDE sums[k] += AT(columns) * AT(columns + j * stride);
        out[j] = wide_in_pairs(sums);
    }
}

/* Subtract `factor` times b from a. Returns the product sum of the result and `other`, or itself if
   this is NULL. */
INLINE double subtract_and_sum(double *a, double factor, const double *b, const double *other,
                               int64_t rows) {
    wide sums[WIDES] = {0};
    for (int64_t i = 0; i < rows; i += 8)
        EACH_WIDE {
            wide value = AT(a) - factor * AT(b);
            ((wide *)(a + i))[k] = value;
            sums[k] += value * (other ? AT(other) : value);
        }
    return wide_in_pairs(sums);
}

static double product_sum(const double *a, const double *b, int64_t rows) {
    wide sums[WIDES] = {0};
    int64_t i = 0;
    for (; i + 8 <= rows; i += 8) EACH_WIDE sums[k] += AT(a) * AT(b);
    double each[8];
    numbers_of(sums, each);
    for (int k = 0; i + k < rows; k++) each[k] += a[i + k] * b[i + k];
    return in_pairs(each);
}

static void subtract(double *a, double factor, const double *b, int64_t rows) {
    EACH_ROW for (int64_t i = 0; i < rows; i++) a[i] -= factor * b[i];
}

/* Update T (side, side), the triangular factor of all previous rows, by more rows, given as n
   columns. By Householder reflections of T stacked on the rows (Golub and Van Loan, Matrix
   Computations, section 5.2), chunk by chunk. The rows are whole eights: added zeros change no bit.
   One pass over a column reflects it and sums its products with the next reflected one. Overwrites
   the columns; incomplete after a stop. */
static void fold(double *T, int64_t side, double *columns, int64_t stride, int64_t rows, int64_t n,
                 watch *by) {
    double sums[MOST_PARAMETERS + 1]; /* products of column k and each from k on */
    product_sums(columns, stride, rows, n, sums);
    for (int64_t k = 0; k < n && !stops_after((double)(rows * (n - k)), by); k++) {
        double *v = columns + k * stride, *next = v + stride, *row = T + k * side;
        double square = sums[k], diagonal = row[k];
        if (square < SMALLEST) { /* a column of zeros: 1 / square would overflow */
            product_sums(next, stride, rows, n - k - 1, sums + k + 1);
            continue;
        }
        double norm = -__builtin_copysign(__builtin_sqrt(diagonal * diagonal + square), diagonal);
        double first = diagonal - norm, factor = 2.0 / (first * first + square);
        row[k] = norm;
        for (int64_t j = k + 1; j < n; j++) {
            double product = (first * row[j] + sums[j]) * factor;
            row[j] -= product * first;
            sums[j] = j == k + 1 ? subtract_and_sum(next, product, v, NULL, rows)
                : subtract_and_sum(columns + j * stride, product, v, next, rows);
        }
    }
}

/* Broyden update of the columns (d + 1, m), with the residuals last, after a step of squared length
   `total` in the metric of the scales D, to new residuals (m,). */
static void update_columns(double *columns, const double *residuals, const double *step,
                           const double *D, double total, int64_t d, int64_t m) {
    double missing[MOST_ROWS];
    for (int64_t start = 0; start < m; start += MOST_ROWS) {
        int64_t rows = m - start < MOST_ROWS ? m - start : MOST_ROWS;
        double *last = columns + d * m + start;
        EACH_ROW for (int64_t i = 0; i < rows; i++) missing[i] = residuals[start + i] - last[i];
        for (int64_t k = 0; k < d; k++) subtract(missing, step[k], columns + k * m + start, rows);
        EACH_ROW for (int64_t i = 0; i < rows; i++) missing[i] /= total;
        for (int64_t k = 0; k < d; k++) {
            double *column = columns + k * m + start;
            EACH_ROW for (int64_t i = 0; i < rows; i++)
                column[i] += missing[i] * D[k] * D[k] * step[k];
        }
        memcpy(last, residuals + start, rows * sizeof(double));
    }
}
