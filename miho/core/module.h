/* Parts of the interface to Python, besides module.c. */
#ifndef MIHO_MODULE_H
#define MIHO_MODULE_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include "tape.h"

/* A new reference to None. Headers of Python 3.12 and later take None for immortal in
   Py_RETURN_NONE; in Python 3.11, which the same build serves, it would be freed. */
static inline PyObject *none(void) {
    Py_INCREF(Py_None);
    return Py_None;
}

/* module_search.c */
extern const char run_bracket_doc[];
PyObject *py_run_bracket(PyObject *module, PyObject *const *arguments, Py_ssize_t count);
/* module_triangular.c */
extern const char fold_doc[], solve_in_box_doc[];
PyObject *py_fold(PyObject *module, PyObject *const *arguments, Py_ssize_t count);
PyObject *py_solve_in_box(PyObject *module, PyObject *const *arguments, Py_ssize_t count);
/* module_climb.c */
extern const char climb_doc[];
PyObject *py_climb(PyObject *module, PyObject *const *arguments, Py_ssize_t count);
/* module_many.c */
extern const char fit_many_doc[];
PyObject *py_fit_many(PyObject *module, PyObject *const *arguments, Py_ssize_t count);
/* module_trajectory.c */
extern const char solve_trajectories_doc[], derive_trajectory_doc[];
PyObject *py_solve_trajectories(PyObject *module, PyObject *const *arguments, Py_ssize_t count);
PyObject *py_derive_trajectory(PyObject *module, PyObject *const *arguments, Py_ssize_t count);
/* module_track.c */
extern const char update_population_doc[], mixture_reach_doc[];
PyObject *py_update_population(PyObject *module, PyObject *const *arguments, Py_ssize_t count);
PyObject *py_mixture_reach(PyObject *module, PyObject *const *arguments, Py_ssize_t count);
#endif
