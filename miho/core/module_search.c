/* Interface of the search. All indices and sizes in the arrays are checked here, once. */
#include <string.h>
#include "module_arrays.h"
#include "search.h"

/* Tapes of `kept`, or functions at the addresses `calls`, which cannot be checked. */
static int take_functions(PyObject *calls, PyObject *kept, arrays *all, int64_t inputs,
                          problem *p) {
    const int64_t *address = vector_of(all, calls, "calls", 'l', 4);
    PyObject *value = all->tape[0] = address ? PySequence_GetItem(kept, 0) : NULL;
    PyObject *slopes = all->tape[1] = value ? PySequence_GetItem(kept, 1) : NULL;
    int done = slopes != NULL;
    if (done && PyCapsule_IsValid(value, "tape") && PyCapsule_IsValid(slopes, "tape")) {
        const tape *v = p->value_tape = PyCapsule_GetPointer(value, "tape");
        const tape *g = p->slope_tape = PyCapsule_GetPointer(slopes, "tape");
        p->residuals = tape_residuals;
        p->slopes = tape_columns;
        p->sums = v->level;
        if (v->results != 1 || g->results != p->d || v->parameters != p->d ||
            g->parameters != p->d || v->inputs != inputs || g->inputs != inputs)
            done = refuse(all, "the tapes have other parameters or inputs");
    } else if (done) {
        p->residuals = (residual_function)(uintptr_t)address[0];
        p->slopes = (column_function)(uintptr_t)address[1];
        p->value_tape = (const tape *)(uintptr_t)address[2];
        p->slope_tape = (const tape *)(uintptr_t)address[3];
        p->sums = highest_level();
        if (!address[0] || !address[1]) done = refuse(all, "expected the addresses of functions");
    }
    return done;
}

/* Whether n positions are different parameters out of d. */
static int are_places(const int64_t *places, int64_t n, int64_t d) {
    for (int64_t k = 0; k < n; k++) {
        if (places[k] < 0 || places[k] >= d) return 0;
        for (int64_t j = 0; j < k; j++)
            if (places[j] == places[k]) return 0;
    }
    return 1;
}

static int take_box(PyObject *box, arrays *all, problem *p) {
    PyObject *of[7];
    for (int k = 0; k < 7; k++)
        if (!(of[k] = field_of(all, box, k, 7, "box"))) return 0;
    int64_t any = -1, *n = &any;
    if (!(p->low = array_of(all, of[0], "box.low", 'd', 1, n)) ||
        !(p->high = vector_of(all, of[1], "box.high", 'd', any)) ||
        !(p->origin = vector_of(all, of[2], "box.origin", 'd', any)) ||
        !(p->width = vector_of(all, of[3], "box.width", 'd', any)) ||
        !(p->log = vector_of(all, of[4], "box.log", '?', any))) return 0;
    p->d = any;
    p->linears = p->nonlinears = -1;
    if (!(p->linear = array_of(all, of[5], "box.linear", 'l', 1, &p->linears)) ||
        !(p->nonlinear = array_of(all, of[6], "box.nonlinear", 'l', 1, &p->nonlinears))) return 0;
    if (p->d < 1 || p->d > MOST_PARAMETERS)
        return refuse(all, "too few or too many parameters");
    if (p->linears + p->nonlinears != p->d || !are_places(p->linear, p->linears, p->d) ||
        !are_places(p->nonlinear, p->nonlinears, p->d))
        return refuse(all, "linear and nonlinear parameters do not match the box");
    return 1;
}

static int take_levels(PyObject *rows, arrays *all, problem *p) {
    p->levels = -1;
    if (!(p->level_rows = array_of(all, rows, "level_rows", 'l', 1, &p->levels))) return 0;
    if (p->levels < 1) return refuse(all, "there is no level");
    for (int64_t k = 0, before = 0; k < p->levels; before = p->level_rows[k++])
        if (p->level_rows[k] <= before || p->level_rows[k] > p->N)
            return refuse(all, "expected levels with increasing numbers of rows");
    return 1;
}

static int take_minima(PyObject *minima, arrays *all, const problem *p, known_minima *known) {
    PyObject *of[4];
    for (int k = 0; k < 4; k++)
        if (!(of[k] = field_of(all, minima, k, 4, "minima"))) return 0;
    int64_t x[] = {-1, p->d}, sums[] = {-1, p->levels};
    if (!(known->x = array_of(all, of[0], "minima.x", 'd', 2, x))) return 0;
    sums[0] = known->count = x[0];
    return (known->loss = vector_of(all, of[1], "minima.loss", 'd', known->count)) &&
        (known->sums = array_of(all, of[2], "minima.sums", 'd', 2, sums)) &&
        (known->determined = vector_of(all, of[3], "minima.determined", '?', known->count));
}

static int take_settings(PyObject *settings, const arrays *all, search_settings *to) {
    struct { int64_t *whole; double *number; } fields[] = {
        {&to->eta}, {&to->steps}, {&to->lead}, {.number = &to->reach}, {&to->secants},
        {.number = &to->tolerance}, {.number = &to->level_tolerance}, {.number = &to->digits},
        {.number = &to->patience}, {.number = &to->progress}, {.number = &to->rounding},
        {&to->slope_cost}, {&to->compiled}, {&to->projects}, {&to->solved},
        {.number = &to->rung_budget}, {&to->allowance}, {&to->room},
    };
    for (int k = 0; k < 18; k++) {
        PyObject *value = field_of(all, settings, k, 18, "settings");
        if (!value) return 0;
        if (fields[k].whole) *fields[k].whole = PyLong_AsLongLong(value);
        else *fields[k].number = PyFloat_AsDouble(value);
        if (PyErr_Occurred()) return 0;
    }
    if (to->eta < 2 || to->slope_cost < 0 || to->slope_cost > INT32_MAX)
        return refuse(all, "expected settings.eta >= 2 and settings.slope_cost >= 0");
    return 1;
}

static int take_candidates(PyObject *const *a, arrays *all, search *s) {
    int64_t d = s->p.d;
    int64_t numbers[] = {-1, 4 * d + NUMBERS + s->p.levels};
    if (!(s->numbers = array_of(all, a[0], "numbers", 'D', 2, numbers))) return 0;
    int64_t n = s->n = numbers[0], counts[] = {n, COUNTS}, R[] = {n, d, d};
    s->stored_room = -1;
    if (!(s->counts = array_of(all, a[1], "counts", 'L', 2, counts)) ||
        !(s->R = array_of(all, a[2], "R", 'D', 3, R)) ||
        !(s->stored = array_of(all, a[3], "stored", 'D', 1, &s->stored_room)) ||
        !(s->place = vector_of(all, a[4], "place", 'L', PLACES)) ||
        !(s->order = vector_of(all, a[5], "order", 'L', n))) return 0;
    const int64_t *at = s->place;
    if (at[AT_LEVEL] < 0 || at[AT_LEVEL] >= s->p.levels)
        return refuse(all, "place has an unknown level");
    int64_t m = at[STORED];
    if (at[SIZE] < 0 || at[SIZE] > n || at[ACTIVE] < 0 || at[ACTIVE] > at[SIZE] || m < 0)
        return refuse(all, "place has more candidates than the arrays");
    if (m && (m != s->p.level_rows[at[AT_LEVEL]] ||
              product_of(product_of(at[SIZE], d + 1), m) < 0 ||
              at[SIZE] * (d + 1) * m > s->stored_room))
        return refuse(all, "stored is too small for the derivatives");
    return 1;
}

static int take_report(PyObject *const *a, arrays *all, search *s) {
    int64_t thetas[] = {-1, s->p.d};
    s->events = -1;
    return (s->at = array_of(all, a[0], "at", 'L', 1, &s->events)) &&
        (s->losses = vector_of(all, a[1], "losses", 'D', s->events)) &&
        (thetas[0] = s->events, s->thetas = array_of(all, a[2], "thetas", 'D', 2, thetas)) &&
        (s->tally = vector_of(all, a[3], "tally", 'L', TALLIES));
}

static int take_room(PyObject *room, arrays *all, search *s) {
    int64_t size = -1, rows = s->place[STORED] > CHUNK ? s->place[STORED] : CHUNK;
    double *numbers = array_of(all, room, "room", 'D', 1, &size);
    if (!numbers) return 0;
    if (size < room_beside_residuals(s->p.d, s->p.levels) + rows)
        return refuse(all, "room is too small");
    divide_room(s, numbers, size);
    return 1;
}

/* All arguments, in order. */
static int take(PyObject *const *a, arrays *all, search *s) {
    problem *p = &s->p;
    int64_t X[] = {-1, -1};
    if (!take_box(a[10], all, p) || !(p->X = array_of(all, a[2], "X", 'd', 2, X))) return 0;
    p->N = X[1];
    if (!(p->y = vector_of(all, a[3], "y", 'd', p->N))) return 0;
    if (!take_functions(a[0], a[1], all, X[0], p) || !take_levels(a[11], all, p) ||
        !take_minima(a[12], all, p, &s->minima) || !take_settings(a[13], all, &s->settings) ||
        !take_candidates(a + 4, all, s) || !take_report(a + 17, all, s) ||
        !take_room(a[21], all, s) || !are_apart(all)) return 0;
    s->most = PyLong_AsLongLong(a[14]);
    s->best = PyFloat_AsDouble(a[15]);
    s->target = PyFloat_AsDouble(a[16]);
    if (PyErr_Occurred()) return 0;
    for (int k = 0; k < TALLIES; k++)
        if (s->tally[k]) return refuse(all, "tally is not 0");
    return 1;
}

/* Whether Ctrl-C was pressed. Python handles it after the call, which leaves a whole state. */
static int interrupted(void *state) {
    PyThreadState **thread = state;
    PyEval_RestoreThread(*thread);
    int pressed = PyOS_InterruptOccurred();
    if (pressed) PyErr_SetInterrupt();
    *thread = PyEval_SaveThread();
    return pressed;
}

const char run_bracket_doc[] =
    "run_bracket(calls, kept, X, y, numbers, counts, R, stored, place, order, box, level_rows, "
    "minima, settings, most, best, target, at, losses, thetas, tally, room): run a bracket to its "
    "end, or as far as allowed; returns how it ended. See "
    "miho.compiled.phases.bracket_of.";
PyObject *py_run_bracket(PyObject *module, PyObject *const *a, Py_ssize_t count) {
    if (count != 22) return PyErr_Format(PyExc_TypeError, "run_bracket takes 22 arguments");
    arrays all;
    begin_call(&all, "run_bracket");
    search s;
    memset(&s, 0, sizeof s);
    int taken = take(a, &all, &s), ended = 0;
    if (taken) {
        PyThreadState *thread = PyEval_SaveThread();
        watch by = {interrupted, &thread, 0.0, 0};
        s.w.solver.by = &by;
        ended = run_bracket(&s);
        PyEval_RestoreThread(thread);
    }
    release_arrays(&all);
    return taken ? PyLong_FromLong(ended) : NULL;
}
