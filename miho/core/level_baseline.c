/* The operations with the instructions of every processor of its kind. */
#define LEVEL baseline
#include "operations.h"
