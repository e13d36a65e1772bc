/* miho.core._machine: the interface to Python. Tapes are checked here, once. */
#include <string.h>
#include "module_arrays.h"

#define LONG_CALL 2000 /* model values from which other threads may run */

static const level *const every_level[] = {&level_baseline, &level_avx2, &level_avx512};

#if defined(__x86_64__) && defined(_WIN32) /* no library has the function below */
#include <cpuid.h>

static int count_of_levels(void) {
    unsigned a, b, c, d, saved, high; /* `saved`: registers that the system saves */
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_OSXSAVE)) return 1;
    __asm__("xgetbv" : "=a"(saved), "=d"(high) : "c"(0));
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || (saved & 0x6) != 0x6 || !(b & bit_AVX2))
        return 1;
    unsigned wanted = bit_AVX512F | bit_AVX512DQ | bit_AVX512VL | bit_AVX512BW;
    return (saved & 0xe6) == 0xe6 && (b & wanted) == wanted ? 3 : 2;
}
#else
static int count_of_levels(void) {
#if defined(__x86_64__)
    __builtin_cpu_init();
    if (!__builtin_cpu_supports("avx2")) return 1;
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw") ? 3 : 2;
#else
    return 1;
#endif
}
#endif

const level *highest_level(void) { return every_level[count_of_levels() - 1]; }

static const struct { const char *name; int operands, results; } known[] = {
#define AS_ROW(name, operands, results) {#name, operands, results},
    OPERATIONS(AS_ROW)
};

/* Whether an instruction reads defined values and writes where it may. */
static int fits(const instruction *q, int once, const tape *t) {
    int places = once ? t->scalars : t->registers;
    int first = once ? t->constants + t->parameters : t->inputs;
    if (q->op < 0 || q->op >= COUNT_OF_OPERATIONS) return 0;
    int scalar = q->op >= OP_ADD_S && q->op <= OP_S_DIV;
    if (scalar && once) return 0;
    for (int k = 0; k < 4; k++) {
        int most = scalar && k == 1 ? t->scalars : places;
        if (q->operand[k] < 0 || q->operand[k] >= most) return 0;
    }
    for (int k = 0; k < 2; k++) {
        int written = k < known[q->op].results;
        if (q->result[k] < (written ? first : 0) || q->result[k] >= places) return 0;
    }
    if (known[q->op].results < 2) return 1;
    /* The first result of a row is written before all operands are read. */
    for (int k = 0; k < known[q->op].operands; k++)
        if (q->operand[k] == q->result[0] || q->operand[k] == q->result[1]) return 0;
    return q->result[0] != q->result[1];
}

/* First fault of a tape, NULL if there is none. */
static const char *fault(const tape *t) {
    const int32_t *counts = &t->inputs;
    for (int k = 0; k < 9; k++)
        if (counts[k] < 0) return "a count is negative";
    if (t->registers > MOST_REGISTERS || t->scalars > MOST_REGISTERS) return "too many registers";
    if (t->results < 1 || t->inputs > t->registers || t->results > t->registers - t->inputs)
        return "too few registers";
    if (t->constants > t->scalars || t->parameters > t->scalars - t->constants)
        return "too few scalars";
    for (int k = 0; k < t->once + t->length; k++)
        if (!fits(t->code + k, k < t->once, t)) return "an instruction is out of bounds";
    for (int k = 0; k < t->fills; k++) {
        int to = t->fill[2 * k], from = t->fill[2 * k + 1];
        if (to < t->inputs + t->results || to >= t->registers || from < 0 || from >= t->scalars)
            return "a fill is out of bounds";
    }
    return NULL;
}

static void drop(PyObject *capsule) { PyMem_Free(PyCapsule_GetPointer(capsule, "tape")); }

PyDoc_STRVAR(tape_doc, "tape(counts, code, constants, fills, level=-1): a tape, from arrays of "
    "int32 and doubles, for a level of instructions (-1: the highest). ValueError if not valid.");
static PyObject *py_tape(PyObject *module, PyObject *args) {
    Py_buffer counts = {0}, code = {0}, constants = {0}, fills = {0};
    int chosen = -1, levels = count_of_levels();
    if (!PyArg_ParseTuple(args, "y*y*y*y*|i", &counts, &code, &constants, &fills, &chosen))
        return NULL;
    const char *why = NULL;
    tape *t = NULL;
    int32_t c[9];
    if (chosen < -1 || chosen >= levels) why = "this processor has no such level";
    else if (counts.len != sizeof c) why = "nine counts are expected";
    else {
        memcpy(c, counts.buf, sizeof c);
        if (c[6] < 0 || c[7] < 0 || c[6] > MOST_LENGTH || c[7] > MOST_LENGTH) why = "too long";
        else if (c[3] < 0 || c[8] < 0 || c[8] > MOST_LENGTH) why = "too long";
        else if (code.len != (Py_ssize_t)sizeof(instruction) * (c[6] + c[7]) ||
                 constants.len != (Py_ssize_t)sizeof(double) * c[3] ||
                 fills.len != (Py_ssize_t)sizeof(int32_t) * 2 * c[8]) why = "a length differs";
    }
    if (!why) t = PyMem_Malloc(sizeof *t + constants.len + code.len + fills.len);
    if (!why && !t) PyErr_NoMemory();
    if (t) {
        char *room = (char *)(t + 1);
        memcpy(&t->inputs, c, sizeof c);
        t->constant = memcpy(room, constants.buf, constants.len);
        t->code = memcpy(room + constants.len, code.buf, code.len);
        t->fill = memcpy(room + constants.len + code.len, fills.buf, fills.len);
        t->level = every_level[chosen < 0 ? levels - 1 : chosen];
        why = fault(t);
    }
    PyBuffer_Release(&counts); PyBuffer_Release(&code);
    PyBuffer_Release(&constants); PyBuffer_Release(&fills);
    if (why) PyErr_Format(PyExc_ValueError, "no tape: %s", why);
    if (why || !t) { PyMem_Free(t); return NULL; }
    return PyCapsule_New(t, "tape", drop);
}

PyDoc_STRVAR(evaluate_doc,
    "evaluate(tape, thetas (n, d), X (p, N), out (n, results, N)): fill out.");
static PyObject *py_evaluate(PyObject *module, PyObject *const *a, Py_ssize_t count) {
    if (count != 4) return PyErr_Format(PyExc_TypeError, "evaluate takes 4 arguments");
    const tape *t = PyCapsule_GetPointer(a[0], "tape");
    if (!t) return NULL;
    arrays all;
    begin_call(&all, "evaluate");
    int64_t n[] = {-1, t->parameters}, N[] = {t->inputs, -1};
    double *out = NULL, *thetas = array_of(&all, a[1], "thetas", 'd', 2, n);
    double *X = thetas ? array_of(&all, a[2], "X", 'd', 2, N) : NULL;
    int64_t shape[] = {n[0], t->results, N[1]};
    int done = 0, taken = X && (out = array_of(&all, a[3], "out", 'D', 3, shape)) != NULL;
    if (taken && n[0] * N[1] < LONG_CALL) done = tape_evaluate(t, thetas, n[0], X, N[1], out);
    else if (taken) {
        Py_BEGIN_ALLOW_THREADS
        done = tape_evaluate(t, thetas, n[0], X, N[1], out);
        Py_END_ALLOW_THREADS
    }
    return end_call(&all, taken, done);
}

PyDoc_STRVAR(mean_squares_doc,
    "mean_squares(tape, thetas (n, d), X (p, N), y (rows,), first, out (n,)): fill out with means "
    "of (result - y)^2 over the first rows of X, in blocks; the first block has `first` rows.");
static PyObject *py_mean_squares(PyObject *module, PyObject *const *a, Py_ssize_t count) {
    if (count != 6) return PyErr_Format(PyExc_TypeError, "mean_squares takes 6 arguments");
    const tape *t = PyCapsule_GetPointer(a[0], "tape");
    measurements d = {.first = PyLong_AsLongLong(a[4])};
    if (PyErr_Occurred()) return NULL;
    arrays all;
    begin_call(&all, "mean_squares");
    int64_t n[] = {-1, t->parameters}, N[] = {t->inputs, -1}, rows = -1;
    double *thetas = array_of(&all, a[1], "thetas", 'd', 2, n), *out = NULL;
    int done = 0, taken = thetas && (d.X = array_of(&all, a[2], "X", 'd', 2, N)) &&
        (d.y = array_of(&all, a[3], "y", 'd', 1, &rows)) &&
        (out = vector_of(&all, a[5], "out", 'D', n[0]));
    d.N = N[1];
    d.rows = rows;
    if (taken && (rows < 1 || rows > d.N || d.first < 1 || t->results != 1))
        taken = refuse(&all, "expected a tape of one result, no more data than rows of X, and a "
                       "first block");
    if (taken) {
        Py_BEGIN_ALLOW_THREADS
        done = tape_mean_squares(t, thetas, n[0], &d, out);
        Py_END_ALLOW_THREADS
    }
    return end_call(&all, taken, done);
}

PyDoc_STRVAR(address_doc, "address(tape): its address for compiled code, while the tape lives.");
static PyObject *py_address(PyObject *module, PyObject *capsule) {
    void *t = PyCapsule_GetPointer(capsule, "tape");
    return t ? PyLong_FromVoidPtr(t) : NULL;
}

PyDoc_STRVAR(functions_doc,
    "functions(): addresses of tape_residuals and tape_columns (tape.h).");
static PyObject *py_functions(PyObject *module, PyObject *none) {
    return Py_BuildValue("NN", PyLong_FromVoidPtr((void *)(uintptr_t)tape_residuals),
                         PyLong_FromVoidPtr((void *)(uintptr_t)tape_columns));
}

PyDoc_STRVAR(levels_doc, "levels(): names of the levels of instructions that this processor has.");
static PyObject *py_levels(PyObject *module, PyObject *none) {
    int levels = count_of_levels();
    PyObject *names = PyTuple_New(levels);
    for (int k = 0; names && k < levels; k++)
        PyTuple_SetItem(names, k, PyUnicode_FromString(every_level[k]->name));
    return names;
}

PyDoc_STRVAR(operations_doc, "operations(): their names, in the order of their numbers.");
static PyObject *py_operations(PyObject *module, PyObject *none) {
    PyObject *names = PyTuple_New(COUNT_OF_OPERATIONS);
    for (int k = 0; names && k < COUNT_OF_OPERATIONS; k++)
        PyTuple_SetItem(names, k, PyUnicode_FromString(known[k].name));
    return names;
}

PyDoc_STRVAR(sources_doc, "sources(): checksum of the sources, as by miho.core.tape.checksum.");
static PyObject *py_sources(PyObject *module, PyObject *none) {
    return PyLong_FromUnsignedLong(MIHO_SOURCES);
}

#define FAST(function) (PyCFunction)(void (*)(void))(function), METH_FASTCALL
static PyMethodDef methods[] = {
    {"tape", py_tape, METH_VARARGS, tape_doc},
    {"evaluate", FAST(py_evaluate), evaluate_doc},
    {"mean_squares", FAST(py_mean_squares), mean_squares_doc},
    {"run_bracket", FAST(py_run_bracket), run_bracket_doc},
    {"fold", FAST(py_fold), fold_doc},
    {"solve_in_box", FAST(py_solve_in_box), solve_in_box_doc},
    {"climb", FAST(py_climb), climb_doc},
    {"fit_many", FAST(py_fit_many), fit_many_doc},
    {"solve_trajectories", FAST(py_solve_trajectories), solve_trajectories_doc},
    {"derive_trajectory", FAST(py_derive_trajectory), derive_trajectory_doc},
    {"update_population", FAST(py_update_population), update_population_doc},
    {"mixture_reach", FAST(py_mixture_reach), mixture_reach_doc},
    {"address", py_address, METH_O, address_doc},
    {"functions", py_functions, METH_NOARGS, functions_doc},
    {"levels", py_levels, METH_NOARGS, levels_doc},
    {"operations", py_operations, METH_NOARGS, operations_doc},
    {"sources", py_sources, METH_NOARGS, sources_doc},
    {NULL, NULL, 0, NULL},
};
static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_machine", "Tapes of formulas.", 0, methods, NULL, NULL, NULL, NULL,
};
PyMODINIT_FUNC PyInit__machine(void) { return PyModule_Create(&definition); }
