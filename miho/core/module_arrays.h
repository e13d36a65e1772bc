/* Arrays and records that a call from Python gives, each checked before it is used. */
#ifndef MIHO_MODULE_ARRAYS_H
#define MIHO_MODULE_ARRAYS_H

#include "module.h"

#define MOST_ARRAYS 32

/* What a call of `caller` holds until it ends. */
typedef struct {
    const char *caller;
    Py_buffer view[MOST_ARRAYS];
    PyObject *tape[2];
    int count;
} arrays;

/* The numbers of an array in one piece, of so many axes; NULL, with an error, if it is another one.
   `kind` is d (numbers), l (whole numbers) or ?; a capital is for one that is written, B for ?. Axes of
   `shape` that are negative are found out. */
void *array_of(arrays *all, PyObject *o, const char *name, char kind, int axes, int64_t *shape);
void *vector_of(arrays *all, PyObject *o, const char *name, char kind, int64_t n);
/* Field k of a record of `count`, a borrowed reference. */
PyObject *field_of(const arrays *all, PyObject *record, Py_ssize_t k, Py_ssize_t count,
                const char *name);
/* Set an error, and give 0. */
int refuse(const arrays *all, const char *what);
void release_arrays(arrays *all);
/* The product, negative if it is too large. */
int64_t product_of(int64_t a, int64_t b);
#endif
