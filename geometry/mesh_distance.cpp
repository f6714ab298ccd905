#include "geometry/mesh_distance.h"
