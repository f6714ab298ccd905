#include "geometry/mesh_lod.h"
