/* Arrays and records from Python. */
#include "module_arrays.h"

int64_t product_of(int64_t a, int64_t b) {
    int64_t product;
    return __builtin_mul_overflow(a, b, &product) ? -1 : product;
}

void begin_call(arrays *all, const char *caller) {
    all->caller = caller;
    all->count = 0;
    all->tape[0] = all->tape[1] = NULL;
}

void *array_of(arrays *all, PyObject *o, const char *name, char kind, int axes, int64_t *shape) {
    int writable = kind < 'a' && kind != '?';
    char expected = kind == 'B' ? '?' : writable ? (char)(kind + ('a' - 'A')) : kind;
    Py_buffer *view = &all->view[all->count];
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (writable ? PyBUF_WRITABLE : 0);
    if (all->count == MOST_ARRAYS || PyObject_GetBuffer(o, view, flags)) return NULL;
    all->is_written[all->count++] = writable;
    char is = view->format ? view->format[0] : 'B';
    int fits = view->ndim == axes && (is == expected || (is == 'q' && expected == 'l')) &&
        view->itemsize == (expected == '?' ? 1 : 8) && !view->format[1];
    for (int k = 0; fits && k < axes; k++) {
        if (shape[k] < 0) shape[k] = view->shape[k];
        fits = shape[k] == view->shape[k];
    }
    if (fits) return view->buf;
    PyErr_Format(PyExc_ValueError, "%s: %s has another type or shape than expected", all->caller,
                 name);
    return NULL;
}

void *vector_of(arrays *all, PyObject *o, const char *name, char kind, int64_t n) {
    return array_of(all, o, name, kind, 1, &n);
}

int are_apart(const arrays *all) {
    for (int k = 0; k < all->count; k++)
        for (int j = 0; j < k; j++) {
            const Py_buffer *a = &all->view[j], *b = &all->view[k];
            uintptr_t from = (uintptr_t)a->buf, other = (uintptr_t)b->buf;
            int meet = from < other + (uintptr_t)b->len && other < from + (uintptr_t)a->len;
            if (meet && a->len && b->len && (all->is_written[j] || all->is_written[k]))
                return refuse(all, "an array that is written overlaps another one");
        }
    return 1;
}

PyObject *field_of(const arrays *all, PyObject *record, Py_ssize_t k, Py_ssize_t count,
                const char *name) {
    if (PyTuple_Check(record) && PyTuple_Size(record) == count) return PyTuple_GetItem(record, k);
    PyErr_Format(PyExc_TypeError, "%s: %s is no record of %zd fields", all->caller, name, count);
    return NULL;
}

int refuse(const arrays *all, const char *what) {
    PyErr_Format(PyExc_ValueError, "%s: %s", all->caller, what);
    return 0;
}

void release_arrays(arrays *all) {
    for (int k = 0; k < all->count; k++) PyBuffer_Release(&all->view[k]);
    for (int k = 0; k < 2; k++) Py_XDECREF(all->tape[k]);
}

PyObject *end_call(arrays *all, int taken, int done) {
    release_arrays(all);
    if (taken && done) return none();
    return taken ? PyErr_NoMemory() : NULL;
}
