/* Interface of many fits. All indices and sizes in the arrays are checked here, once. */
#include "many.h"
#include "module_arrays.h"

static int take_tape(PyObject *capsule, arrays *all, many_data *to) {
    if (!PyCapsule_IsValid(capsule, "tape")) return refuse(all, "the first argument is no tape");
    to->tape = PyCapsule_GetPointer(capsule, "tape");
    to->d = to->tape->parameters;
    if (to->d < 1 || to->d > MOST_PARAMETERS)
        return refuse(all, "too few or too many parameters");
    if (to->tape->results != to->d + 1)
        return refuse(all, "expected a tape of derivatives and value");
    return 1;
}

static int take_data(PyObject *const *a, arrays *all, many_data *to) {
    int64_t X[] = {to->tape->inputs, -1}, rows = -1, ends = -1;
    if (!(to->X = array_of(all, a[1], "X", 'd', 2, X)) ||
        !(to->y = array_of(all, a[2], "y", 'd', 1, &rows)) ||
        !(to->ends = array_of(all, a[3], "ends", 'l', 1, &ends))) return 0;
    to->N = X[1];
    to->datasets = ends - 1;
    if ((to->shared = PyObject_IsTrue(a[4])) < 0) return 0;
    if (to->datasets < 1 || to->N < 1 || to->ends[0] || to->ends[ends - 1] != rows)
        return refuse(all, "ends do not match the rows of y");
    if (!to->shared && to->N != rows) return refuse(all, "X and y differ in length");
    for (int64_t k = 0; k < to->datasets; k++) {
        int64_t from = to->ends[k], end = to->ends[k + 1];
        if (end > rows || end <= from || (to->shared && end - from != to->N))
            return refuse(all, "a dataset is empty, or not as long as X");
    }
    return 1;
}

static int take_box(PyObject *box, arrays *all, many_data *to) {
    PyObject *of[4];
    for (int k = 0; k < 4; k++)
        if (!(of[k] = field_of(all, box, k, 4, "box"))) return 0;
    to->linears = -1;
    if (!(to->low = vector_of(all, of[0], "box.low", 'd', to->d)) ||
        !(to->high = vector_of(all, of[1], "box.high", 'd', to->d)) ||
        !(to->log = vector_of(all, of[2], "box.log", '?', to->d)) ||
        !(to->linear = array_of(all, of[3], "box.linear", 'l', 1, &to->linears))) return 0;
    for (int64_t k = 0; k < to->linears; k++)
        if (to->linear[k] < (k ? to->linear[k - 1] + 1 : 0) || to->linear[k] >= to->d)
            return refuse(all, "expected ascending positions of linear parameters");
    return 1;
}

static int take_starts(PyObject *record, arrays *all, int64_t d, int64_t n, many_starts *to) {
    PyObject *starts = field_of(all, record, 0, 3, "starts");
    int64_t shape[] = {-1, -1, d};
    if (!starts || !(to->starts = array_of(all, starts, "starts", 'd', 3, shape))) return 0;
    to->brackets = shape[0];
    to->size = shape[1];
    to->few = PyLong_AsLongLong(field_of(all, record, 1, 3, "starts"));
    to->own = PyObject_IsTrue(field_of(all, record, 2, 3, "starts"));
    if (PyErr_Occurred()) return 0;
    if (to->brackets < 1 || to->size < 1) return refuse(all, "there are no starts");
    if (to->own && to->brackets != 1 && to->brackets != n)
        return refuse(all, "expected starts for all, or for each dataset");
    return 1;
}

static int take_which(PyObject *o, arrays *all, const many_data *data, const int64_t **which,
                      int64_t *n) {
    *n = -1;
    if (!(*which = array_of(all, o, "which", 'l', 1, n))) return 0;
    for (int64_t k = 0; k < *n; k++)
        if ((*which)[k] < 0 || (*which)[k] >= data->datasets)
            return refuse(all, "which has an index without a dataset");
    return 1;
}

static int take_ends(PyObject *const *a, arrays *all, int64_t d, int64_t n, many_ends *to) {
    int64_t thetas[] = {n, d}, covariance[] = {n, d, d}, flags[] = {n, FLAGS};
    return (to->thetas = array_of(all, a[8], "thetas", 'D', 2, thetas)) &&
        (to->squares = vector_of(all, a[9], "squares", 'D', n)) &&
        (to->covariance = array_of(all, a[10], "covariance", 'D', 3, covariance)) &&
        (to->flags = array_of(all, a[11], "flags", 'B', 2, flags));
}

/* Whether a signal has arrived, for example Ctrl-C. */
static int signalled(void *state) {
    PyThreadState **thread = state;
    PyEval_RestoreThread(*thread);
    int raised = PyErr_CheckSignals();
    *thread = PyEval_SaveThread();
    return raised != 0;
}

const char fit_many_doc[] =
    "fit_many(tape, X (p, N), y, ends (M + 1,), shared, box, starts, which (n,), thetas "
    "(n, d), squares (n,), covariance (n, d, d), flags (n, 3)): fill the last four. See many.h.";
PyObject *py_fit_many(PyObject *module, PyObject *const *a, Py_ssize_t count) {
    if (count != 12) return PyErr_Format(PyExc_TypeError, "fit_many takes 12 arguments");
    arrays all;
    begin_call(&all, "fit_many");
    many_data data;
    many_starts starts;
    many_ends ends;
    const int64_t *which;
    int64_t n;
    int taken = take_tape(a[0], &all, &data) && take_data(a, &all, &data) &&
        take_box(a[5], &all, &data) && take_which(a[7], &all, &data, &which, &n) &&
        take_starts(a[6], &all, data.d, n, &starts) && take_ends(a, &all, data.d, n, &ends) &&
        are_apart(&all);
    int done = 0;
    if (taken) {
        PyThreadState *thread = PyEval_SaveThread();
        watch by = {signalled, &thread, 0.0, 0};
        done = fit_many(&data, &starts, which, n, &by, &ends);
        PyEval_RestoreThread(thread);
    }
    return end_call(&all, taken && !PyErr_Occurred(), done);
}
