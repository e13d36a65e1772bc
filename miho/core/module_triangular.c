/* Interface of factors and small problems, for searches whose residuals come from Python. */
#include <stdlib.h>
#include "module_arrays.h"
#include "search.h"

/* Whether Ctrl-C was pressed; the call then raises. */
static int is_pressed(void *state) { return PyOS_InterruptOccurred(); }

/* Return nothing, or raise KeyboardInterrupt. */
static PyObject *ended(const watch *by) {
    if (!by->stopped) return none();
    PyErr_SetNone(PyExc_KeyboardInterrupt);
    return NULL;
}

const char fold_doc[] =
    "fold(T (side, side), columns (k, stride), rows, n): update the factor T by rows, given as n "
    "columns, which are overwritten. See miho.compiled.triangular.fold.";
PyObject *py_fold(PyObject *module, PyObject *const *a, Py_ssize_t count) {
    if (count != 4) return PyErr_Format(PyExc_TypeError, "fold takes 4 arguments");
    arrays all;
    begin_call(&all, "fold");
    watch by = {is_pressed, NULL, 0.0, 0};
    int64_t side[] = {-1, -1}, shape[] = {-1, -1};
    int64_t rows = PyLong_AsLongLong(a[2]), n = PyLong_AsLongLong(a[3]);
    double *T = NULL, *columns = NULL;
    int taken = !PyErr_Occurred() && (T = array_of(&all, a[0], "T", 'D', 2, side)) &&
        (columns = array_of(&all, a[1], "columns", 'D', 2, shape)) && are_apart(&all);
    if (taken && (n < 0 || n > side[0] || n > side[1] || n > shape[0] || n > MOST_PARAMETERS + 1 ||
                  rows < 0 || rows > shape[1] || whole(rows) > shape[1]))
        taken = refuse(&all, "expected no more rows, in eights, and columns than the arrays have");
    if (taken) {
        for (int64_t k = 0; k < n; k++) pad(columns + k * shape[1], rows);
        highest_level()->fold(T, side[1], columns, shape[1], whole(rows), n, &by);
    }
    release_arrays(&all);
    return taken ? ended(&by) : NULL;
}

/* Numbers of the first n parameters. */
static int take_first(arrays *all, PyObject *o, const char *name, int64_t n, const double **to) {
    int64_t size = -1;
    *to = array_of(all, o, name, 'd', 1, &size);
    return *to && (size >= n || refuse(all, "a vector is shorter than the step"));
}

static int take_box_problem(arrays *all, PyObject *const *a, int64_t n, box_problem *b) {
    int64_t shape[] = {-1, -1};
    b->n = n;
    b->step = 1;
    if (n < 0 || n > MOST_PARAMETERS) return refuse(all, "too many parameters");
    if (!(b->R = array_of(all, a[0], "R", 'd', 2, shape))) return 0;
    b->side = shape[1];
    if (shape[0] < n || shape[1] < n) return refuse(all, "R has fewer parameters than the step");
    return take_first(all, a[1], "q", n, &b->q) && take_first(all, a[2], "scale", n, &b->scale) &&
        take_first(all, a[3], "low", n, &b->low) && take_first(all, a[4], "high", n, &b->high);
}

const char solve_in_box_doc[] =
    "solve_in_box(R (side, side), q, scale, low, high, s (n,)): minimise |R s + q|^2 + |scale s|^2 "
    "within the bounds, into s. See miho.compiled.triangular.solve_in_box.";
PyObject *py_solve_in_box(PyObject *module, PyObject *const *a, Py_ssize_t count) {
    if (count != 6) return PyErr_Format(PyExc_TypeError, "solve_in_box takes 6 arguments");
    arrays all;
    begin_call(&all, "solve_in_box");
    box_problem b;
    int64_t n = -1;
    double *s = array_of(&all, a[5], "s", 'D', 1, &n), *room = NULL;
    int taken = s && take_box_problem(&all, a, n, &b) && are_apart(&all);
    watch by = {is_pressed, NULL, 0.0, 0};
    int64_t side = n + 1, size = 2 * n + side * (side + whole(2 * n)) + 7;
    if (taken && !(room = malloc((size_t)size * sizeof(double)))) {
        PyErr_NoMemory();
        taken = 0;
    }
    if (taken) {
        double *T = room + 2 * n, *columns = aligned(T + side * side);
        solver_room solver = {room, room + n, columns, T, n, highest_level(), &by};
        solve_in_box(&b, s, &solver);
    }
    free(room);
    release_arrays(&all);
    return taken ? ended(&by) : NULL;
}
