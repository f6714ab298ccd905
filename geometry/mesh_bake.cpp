#include "geometry/mesh_bake.h"
