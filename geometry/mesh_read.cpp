#include "geometry/mesh_read.h"
