/* Interface of trajectories. All indices and sizes in the arrays are checked here, once. */
#include "module_arrays.h"
#include "trajectory.h"

#define MOST_STEPS (1ll << 40)

/* Whether n integers are at least `low` and below `high`. */
static int within(const int64_t *numbers, int64_t n, int64_t low, int64_t high) {
    for (int64_t k = 0; k < n; k++)
        if (numbers[k] < low || numbers[k] >= high) return 0;
    return 1;
}

/* Field k of the course, an array with this number of axes. */
static void *of_course(arrays *all, PyObject *record, int k, char kind, int axes, int64_t *shape) {
    static const char *const names[] = {
        "t", "u", "substeps", "held", "first", "rows", "output", "reset", "values", "parameters",
    };
    PyObject *o = field_of(all, record, k, 11, "course");
    return o ? array_of(all, o, names[k], kind, axes, shape) : NULL;
}

static int take_flags(arrays *all, PyObject *record, course *c) {
    PyObject *substeps = field_of(all, record, 2, 11, "course");
    if (!substeps) return 0;
    c->substeps = PyLong_AsLongLong(substeps);
    c->held = PyObject_IsTrue(PyTuple_GetItem(record, 3));
    c->restart = PyObject_IsTrue(PyTuple_GetItem(record, 10));
    if (PyErr_Occurred()) return 0;
    if (c->substeps < 1 || c->substeps > MOST_STEPS) return refuse(all, "substeps is out of range");
    return 1;
}

/* Course with S states, K outputs and d parameters. */
static int take_course(arrays *all, PyObject *record, course *c) {
    c->N = c->R = -1;
    if (!take_flags(all, record, c) || !(c->t = of_course(all, record, 0, 'd', 1, &c->N))) return 0;
    int64_t u[] = {c->N, -1}, after[] = {c->N + 1}, starts[] = {-1, c->S};
    if (!(c->u = of_course(all, record, 1, 'd', 2, u)) ||
        !(c->first = of_course(all, record, 4, 'l', 1, after)) ||
        !(c->rows = of_course(all, record, 5, 'l', 1, &c->R)) ||
        !(c->output = of_course(all, record, 6, 'l', 1, &c->R)) ||
        !(c->reset = of_course(all, record, 7, 'l', 1, &c->N)) ||
        !(c->values = of_course(all, record, 8, 'd', 2, starts)) ||
        !(c->parameters = of_course(all, record, 9, 'l', 2, starts))) return 0;
    c->q = u[1];
    c->M = starts[0];
    if (c->N < 1 || c->reset[0] < 0) return refuse(all, "there is no start");
    if (!within(c->reset, c->N, -1, c->M) || !within(c->parameters, c->M * c->S, -1, c->d))
        return refuse(all, "reset has an index without a start");
    if (!within(c->rows, c->R, 0, c->R) || !within(c->output, c->R, 0, c->K) ||
        !within(c->first, c->N + 1, 0, c->R + 1))
        return refuse(all, "an index of a row or an output is out of range");
    return 1;
}

static const tape *tape_in(PyObject *o) {
    return PyCapsule_IsValid(o, "tape") ? PyCapsule_GetPointer(o, "tape") : NULL;
}

/* Tapes of rates and outputs, which determine the numbers of states, outputs and parameters. */
static int take_motion(arrays *all, PyObject *rates, PyObject *outputs, motion *m, course *c) {
    m->rates = tape_in(rates);
    m->outputs = tape_in(outputs);
    if (!m->rates || !m->outputs) return refuse(all, "expected tapes as rates and outputs");
    c->S = m->rates->results;
    c->K = m->outputs->results;
    c->d = (int64_t)m->rates->inputs - c->S;
    if (c->d < 0 || m->outputs->inputs != m->rates->inputs || m->rates->parameters < 1 ||
        m->outputs->parameters != m->rates->parameters)
        return refuse(all, "rates and outputs differ in states, inputs or parameters");
    return 1;
}

/* Derivatives of `rows` rates or outputs: (tape, at). */
static int take_slopes(arrays *all, PyObject *record, int64_t rows, const course *c, slopes *of) {
    PyObject *held = field_of(all, record, 0, 2, "slopes");
    PyObject *at = held ? field_of(all, record, 1, 2, "slopes") : NULL;
    if (!at) return 0;
    of->tape = tape_in(held);
    if (!of->tape) return refuse(all, "slopes have no tape");
    int64_t shape[] = {of->tape->results, 2};
    if (!(of->at = array_of(all, at, "slopes.at", 'l', 2, shape))) return 0;
    of->count = shape[0];
    of->rows = rows;
    of->states = c->S;
    of->width = c->d < 8 ? 8 : (c->d + 7) / 8 * 8;
    if (of->tape->inputs != 1 + c->q + c->S || of->tape->parameters != c->d)
        return refuse(all, "slopes have other states, inputs or parameters");
    for (of->chained = 0; of->chained < of->count; of->chained++)
        if (of->at[2 * of->chained + 1] >= c->S) break;
    for (int64_t i = 0; i < of->count; i++) {
        const int64_t *is = of->at + 2 * i;
        int by_state = i < of->chained, first = !i || i == of->chained;
        if (is[0] < (first ? 0 : is[-2]) || is[0] >= rows || is[1] < (by_state ? 0 : c->S) ||
            is[1] >= (by_state ? c->S : c->S + c->d))
            return refuse(all, "expected slopes by states, then by parameters, in order of rows");
    }
    return 1;
}

static int take_both(arrays *all, PyObject *const *tapes, PyObject *record, motion *m, course *c) {
    if (!take_motion(all, tapes[0], tapes[1], m, c) || !take_course(all, record, c)) return 0;
    if (c->q + 1 != m->rates->parameters) return refuse(all, "the course has other inputs");
    return 1;
}

const char solve_trajectories_doc[] =
    "solve_trajectories(rates, outputs, thetas (n, d), course, out (n, R)): fill out. The tapes of "
    "rates and outputs have the inputs x and p, and the parameters t and u.";
PyObject *py_solve_trajectories(PyObject *module, PyObject *const *a, Py_ssize_t count) {
    if (count != 5) return PyErr_Format(PyExc_TypeError, "solve_trajectories takes 5 arguments");
    arrays all;
    begin_call(&all, "solve_trajectories");
    motion m;
    course c;
    const double *thetas = NULL;
    double *out = NULL;
    int64_t shape[] = {-1, 0}, size[] = {0, 0};
    int taken = take_both(&all, a, a[3], &m, &c), done = 0;
    if (taken) {
        shape[1] = c.d;
        thetas = array_of(&all, a[2], "thetas", 'd', 2, shape);
        size[0] = shape[0];
        size[1] = c.R;
        out = thetas ? array_of(&all, a[4], "out", 'D', 2, size) : NULL;
        taken = out && are_apart(&all);
    }
    if (taken) {
        Py_BEGIN_ALLOW_THREADS
        done = trajectory_solve(&m, &c, thetas, shape[0], out);
        Py_END_ALLOW_THREADS
    }
    return end_call(&all, taken, done);
}

const char derive_trajectory_doc[] =
    "derive_trajectory(rates, outputs, rate_slopes, output_slopes, theta (d,), course, out (R, d))"
    ": fill out. Slopes are a tape of the inputs t, u and x and the parameters p, and the row and "
    "the column of each of its results, in their order.";
PyObject *py_derive_trajectory(PyObject *module, PyObject *const *a, Py_ssize_t count) {
    if (count != 7) return PyErr_Format(PyExc_TypeError, "derive_trajectory takes 7 arguments");
    arrays all;
    begin_call(&all, "derive_trajectory");
    motion m;
    course c;
    slopes of[2];
    const double *theta = NULL;
    double *out = NULL;
    int taken = take_both(&all, a, a[5], &m, &c), done = 0;
    if (taken) {
        int64_t size[] = {c.R, c.d};
        taken = take_slopes(&all, a[2], c.S, &c, &of[0]) &&
            take_slopes(&all, a[3], c.K, &c, &of[1]) &&
            (theta = vector_of(&all, a[4], "theta", 'd', c.d)) &&
            (out = array_of(&all, a[6], "out", 'D', 2, size)) && are_apart(&all);
    }
    if (taken) {
        Py_BEGIN_ALLOW_THREADS
        done = trajectory_derive(&m, of, &c, theta, out);
        Py_END_ALLOW_THREADS
    }
    return end_call(&all, taken, done);
}
