/* The operations with what every processor of its kind has. */
#define LEVEL baseline
#include "operations.h"
