#include "geometry/base_domain.h"
