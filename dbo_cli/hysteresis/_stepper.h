/* One operator, its limits and its state, held from one live sample to the next: see PythonStepper. */
#ifndef DBO_STEPPER_H
#define DBO_STEPPER_H

#include <Python.h>

#include "dbo_kernel.h"

typedef struct {
    PyObject_HEAD
    Py_buffer gears;
    dbo_backlash op;
    dbo_limits limits;
    double largest_change;
    int limited;
    double *decay;
    dbo_fixed_step fixed;
    dbo_fixed_gear *table; /* of `fixed`; NULL where it gives nothing */
    size_t words; /* 64-bit words of a state */
    dbo_backlash_state now;
    dbo_backlash_state next;
    int planned;
    size_t touched; /* words in which the two may differ */
    size_t clipped;
    uint64_t *memory; /* all of it in one piece */
} stepper;

extern PyType_Spec bank_spec;

int is_stepper(PyObject *object);

/* The state to go to, for now that of the present; its buffers stay its own. */
dbo_backlash_state *stepper_copy(stepper *self);

/* The output for an input, and the state to go to. */
double stepper_step(stepper *self, double x);

/* The state to go to, where the output was `y`. */
void stepper_follow(stepper *self, double y);

#endif
