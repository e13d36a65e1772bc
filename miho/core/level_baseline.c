/* The operations with the instructions of every processor of its kind. */
#define LEVEL baseline
#define WIDTH 2 /* doubles in a register */
#include "level.h"
