/* Interface of tracking. All sizes are checked here. */
#include "module_arrays.h"
#include "track.h"

/* (K, d, m, p, q, n), which the tape must have. */
static int take_sizes(PyObject *capsule, PyObject *sizes, arrays *all, track_sizes *to) {
    int64_t *each[] = {&to->K, &to->d, &to->m, &to->p, &to->q, &to->n};
    if (!PyCapsule_IsValid(capsule, "tape")) return refuse(all, "the first argument is no tape");
    to->tape = PyCapsule_GetPointer(capsule, "tape");
    for (int k = 0; k < 6; k++) {
        PyObject *size = field_of(all, sizes, k, 6, "sizes");
        if (!size) return 0;
        *each[k] = PyLong_AsLongLong(size);
        if (PyErr_Occurred()) return 0;
        if (*each[k] < (k < 4) || *each[k] > (k ? MOST_TRACKED : MOST_SLOTS))
            return refuse(all, "a size is out of bounds");
    }
    if (to->q > to->p) return refuse(all, "expected no more noise than inputs");
    if (to->n > to->q || to->n > to->m)
        return refuse(all, "expected no more states than outputs and inputs with noise");
    if (to->tape->inputs != to->p + to->d || to->tape->parameters ||
        to->tape->results != to->m * (1 + to->d + to->q))
        return refuse(all, "the tape has other columns or results than expected");
    return 1;
}

const char update_population_doc[] =
    "update_population(tape, sizes (K, d, m, p, q, n), rules, row (p + m + 1,), memory, estimate): update the "
    "memory by a row, and fill the estimate. See track.h.";
PyObject *py_update_population(PyObject *module, PyObject *const *a, Py_ssize_t count) {
    if (count != 6) return PyErr_Format(PyExc_TypeError, "update_population takes 6 arguments");
    arrays all;
    begin_call(&all, "update_population");
    track_sizes of;
    double *rules, *row, *memory, *estimate;
    int taken = take_sizes(a[0], a[1], &all, &of) &&
        (rules = vector_of(&all, a[2], "rules", 'd', length_of_rules(&of))) &&
        (row = vector_of(&all, a[3], "row", 'd', of.p + of.m + 1)) &&
        (memory = vector_of(&all, a[4], "memory", 'D', length_of_memory(&of))) &&
        (estimate = vector_of(&all, a[5], "estimate", 'D', length_of_estimate(&of))) &&
        are_apart(&all);
    return end_call(&all, taken, taken && track_update(&of, rules, row, memory, estimate));
}

const char mixture_reach_doc[] =
    "mixture_reach(weights (n,), means (n, d), deviations (n, d), centre (d,), probability, out "
    "(d,)): fill out with half widths of intervals.";
PyObject *py_mixture_reach(PyObject *module, PyObject *const *a, Py_ssize_t count) {
    if (count != 6) return PyErr_Format(PyExc_TypeError, "mixture_reach takes 6 arguments");
    arrays all;
    begin_call(&all, "mixture_reach");
    mixture of;
    double *centre, *out;
    int64_t shape[] = {-1, -1};
    double probability = PyFloat_AsDouble(a[4]);
    int taken = !PyErr_Occurred() &&
        (of.means = array_of(&all, a[1], "means", 'd', 2, shape)) &&
        (of.deviations = array_of(&all, a[2], "deviations", 'd', 2, shape)) &&
        (of.weights = vector_of(&all, a[0], "weights", 'd', shape[0])) &&
        (centre = vector_of(&all, a[3], "centre", 'd', shape[1])) &&
        (out = vector_of(&all, a[5], "out", 'D', shape[1])) && are_apart(&all);
    if (taken) {
        of.n = shape[0];
        of.d = shape[1];
        mixture_reach(&of, centre, probability, out);
    }
    return end_call(&all, taken, taken);
}
