# relievo_test(...) lines of tests/geometry
relievo_test(snap_test LIBS relievo_geometry SOURCES geometry/snap_test.cpp)
relievo_test(planar_lod_test LIBS relievo_geometry SOURCES geometry/planar_lod_test.cpp)
relievo_test(lod_error_test LIBS relievo_geometry SOURCES geometry/lod_error_test.cpp)
relievo_test(lod_worker_test LIBS relievo_geometry SOURCES geometry/lod_worker_test.cpp)
relievo_test(texture_select_test LIBS relievo_geometry SOURCES geometry/texture_select_test.cpp)
relievo_test(ray_scene_test LIBS relievo_mesh SOURCES geometry/ray_scene_test.cpp)
relievo_test(mesh_watertight_test LIBS relievo_geometry SOURCES geometry/mesh_watertight_test.cpp)
