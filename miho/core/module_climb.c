/* Interface of mutation steps. All shapes are checked here. */
#include "climb.h"
#include "module_arrays.h"

/* Columns X (p, N), data y (N,), and the rows of the first block. */
static int take_data(arrays *all, PyObject *const *a, const tape *t, measurements *m) {
    int64_t X[] = {t->inputs, -1};
    if (!(m->X = array_of(all, a[0], "X", 'd', 2, X))) return 0;
    m->rows = m->N = X[1];
    m->first = PyLong_AsLongLong(a[2]);
    if (PyErr_Occurred() || !(m->y = vector_of(all, a[1], "y", 'd', m->N))) return 0;
    if (m->first < 1 || m->rows < 1) return refuse(all, "expected rows, and a first block");
    return 1;
}

/* (first, P, L, noise, sigma, (low, high), early_stopping): `Steps` of miho.compiled.kernel. */
static int take_steps(arrays *all, PyObject *record, climb *c) {
    PyObject *of[7];
    for (int k = 0; k < 7; k++)
        if (!(of[k] = field_of(all, record, k, 7, "steps"))) return 0;
    PyObject *low = field_of(all, of[5], 0, 2, "steps.bounds");
    PyObject *high = low ? field_of(all, of[5], 1, 2, "steps.bounds") : NULL;
    if (!high) return 0;
    int64_t P[] = {-1, c->d}, sigma[] = {-1, c->d};
    if (!(c->P = array_of(all, of[1], "steps.P", 'D', 2, P)) ||
        !(c->sigma = array_of(all, of[4], "steps.sigma", 'd', 2, sigma))) return 0;
    c->n = P[0];
    c->more = sigma[0];
    int64_t noise[] = {c->more, c->n, c->d};
    c->early_stopping = PyObject_IsTrue(of[6]);
    return c->early_stopping >= 0 &&
        (c->first = array_of(all, of[0], "steps.first", 'd', 2, P)) &&
        (c->L = vector_of(all, of[2], "steps.L", 'D', c->n)) &&
        (c->noise = array_of(all, of[3], "steps.noise", 'd', 3, noise)) &&
        (c->low = vector_of(all, low, "steps.bounds[0]", 'd', c->d)) &&
        (c->high = vector_of(all, high, "steps.bounds[1]", 'd', c->d));
}

/* Room for an improvement at every evaluation. */
static int take_report(arrays *all, PyObject *const *a, climb *c) {
    int64_t thetas[] = {product_of(c->more + 1, c->n), c->d};
    if (thetas[0] < 0) return refuse(all, "too many steps");
    return (c->at = vector_of(all, a[0], "at", 'L', thetas[0])) &&
        (c->losses = vector_of(all, a[1], "losses", 'D', thetas[0])) &&
        (c->thetas = array_of(all, a[2], "thetas", 'D', 2, thetas));
}

static int take(arrays *all, PyObject *const *a, const tape *t, measurements *m, climb *c) {
    if (t->results != 1) return refuse(all, "expected a tape with one result");
    c->d = t->parameters;
    c->best = PyFloat_AsDouble(a[5]);
    c->target = PyFloat_AsDouble(a[6]);
    if (PyErr_Occurred()) return 0;
    return take_data(all, a + 1, t, m) && take_steps(all, a[4], c) && take_report(all, a + 7, c) &&
        are_apart(all);
}

const char climb_doc[] =
    "climb(tape, X (p, N), y (N,), first, steps, best, target, at, losses, thetas): make steps of "
    "mutation, list improvements; returns the numbers of steps, improvements, and losses that are "
    "NaN and infinite. See miho.compiled.taped.";
PyObject *py_climb(PyObject *module, PyObject *const *a, Py_ssize_t count) {
    if (count != 10) return PyErr_Format(PyExc_TypeError, "climb takes 10 arguments");
    const tape *t = PyCapsule_GetPointer(a[0], "tape");
    if (!t) return NULL;
    arrays all;
    begin_call(&all, "climb");
    measurements m;
    climb c;
    climbed done;
    int taken = take(&all, a, t, &m, &c), ended = 0;
    if (taken) {
        Py_BEGIN_ALLOW_THREADS
        ended = climb_by_tape(t, &m, &c, &done);
        Py_END_ALLOW_THREADS
    }
    release_arrays(&all);
    if (!taken) return NULL;
    if (!ended) return PyErr_NoMemory();
    return Py_BuildValue("LLLL", (long long)done.steps, (long long)done.improvements,
                         (long long)done.nans, (long long)done.infinities);
}
