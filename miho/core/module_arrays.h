/* Arrays and records from Python, each checked before its use. */
#ifndef MIHO_MODULE_ARRAYS_H
#define MIHO_MODULE_ARRAYS_H

#include "module.h"

#define MOST_ARRAYS 32

/* Buffers that a call of `caller` holds until it ends. */
typedef struct {
    const char *caller;
    Py_buffer view[MOST_ARRAYS];
    int is_written[MOST_ARRAYS];
    PyObject *tape[2];
    int count;
} arrays;

/* Without filling the room for all views, which costs as much as a small call. */
void begin_call(arrays *all, const char *caller);
/* Numbers of a contiguous array with this number of axes; NULL, with an error, for another array.
   `kind` is d (floats), l (integers) or ?; in capitals for an output, B for ?. Negative axes of
   `shape` are filled in. */
void *array_of(arrays *all, PyObject *o, const char *name, char kind, int axes, int64_t *shape);
void *vector_of(arrays *all, PyObject *o, const char *name, char kind, int64_t n);
/* Whether no array that is written has memory in common with another; else an error is set. */
int are_apart(const arrays *all);
/* Field k of a record of `count`, a borrowed reference. */
PyObject *field_of(const arrays *all, PyObject *record, Py_ssize_t k, Py_ssize_t count,
                const char *name);
/* Set an error, and return 0. */
int refuse(const arrays *all, const char *what);
void release_arrays(arrays *all);
/* Release the arrays, and return None if a call was `done`; else an error, of memory if its arguments
   were `taken`. */
PyObject *end_call(arrays *all, int taken, int done);
/* Product, negative if it overflows. */
int64_t product_of(int64_t a, int64_t b);
#endif
