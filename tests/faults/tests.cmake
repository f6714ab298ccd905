# Faults injected into the whole program (tests/faults/fault_driver.cpp). Not with sanitizers, whose own allocators and
# interceptors must come first.
if(NOT RELIEVO_SANITIZE)
  add_library(relievo_faults SHARED faults/fault_library.cpp)
  target_link_libraries(relievo_faults PRIVATE ${CMAKE_DL_LIBS})
  add_executable(fault_driver faults/fault_driver.cpp)
  target_link_libraries(fault_driver PRIVATE Threads::Threads)
  add_executable(sloppy_writer faults/sloppy_writer.cpp)
  add_dependencies(fault_driver relievo_faults)

  # A few numbers of every row. All of them: ninja faults_all (some two hours, most of them allocations).
  function(relievo_fault_test name)
    add_test(NAME Faults.${name} COMMAND fault_driver --program $<TARGET_FILE:relievo> --library $<TARGET_FILE:relievo_faults> ${ARGN})
    set_tests_properties(Faults.${name} PROPERTIES TIMEOUT 900 COST 50)
  endfunction()
  relievo_fault_test(BuildImage --only "build image" --tries 2)
  relievo_fault_test(BuildImageMemory --only "build image" --kinds alloc --tries 8)  # most calls come before the image's
  relievo_fault_test(BuildPtm --only "build ptm" --tries 2)
  relievo_fault_test(BuildMesh --only "build mesh" --tries 2)
  relievo_fault_test(BuildMeshMemory --only "build mesh" --kinds alloc --tries 12)
  relievo_fault_test(Verify --only verify --tries 3)
  relievo_fault_test(Info --only info --tries 4)
  relievo_fault_test(Export --only export --tries 3)
  relievo_fault_test(ExportMap --only "export map" --tries 2)
  relievo_fault_test(BuildWithCheckpoints --only checkpoints --tries 2)
  relievo_fault_test(Kills --kills 6)
  relievo_fault_test(KillsAndResume --kills 12 --resume)
  if(RELIEVO_GL_TESTS)
    relievo_fault_test(Render --only render --tries 2)
    relievo_fault_test(RenderScan --only "render scan" --tries 2)
    relievo_fault_test(RenderScanOpen --only "render scan" --kinds open)
    relievo_fault_test(RenderScanSync --only "render scan" --kinds sync)
  endif()
  # The negative controls: what tries nothing is no success, and a program that does all of it wrong is found out.
  add_test(NAME Faults.NothingTriedIsNoSuccess
    COMMAND fault_driver --program $<TARGET_FILE:relievo> --library $<TARGET_FILE:relievo_faults> --only info --kinds open,read)
  set_tests_properties(Faults.NothingTriedIsNoSuccess PROPERTIES PASS_REGULAR_EXPRESSION "nothing was tried")
  add_test(NAME Faults.SloppyWriterIsFoundByFaults
    COMMAND fault_driver --program $<TARGET_FILE:sloppy_writer> --library $<TARGET_FILE:relievo_faults> --only "control" --kinds write)
  set_tests_properties(Faults.SloppyWriterIsFoundByFaults PROPERTIES PASS_REGULAR_EXPRESSION "write ENOSPC 40: exit 0, but o.relievo is not what it should be")
  add_test(NAME Faults.SloppyWriterIsFoundByKills
    COMMAND fault_driver --program $<TARGET_FILE:sloppy_writer> --library $<TARGET_FILE:relievo_faults> --kills 8)
  set_tests_properties(Faults.SloppyWriterIsFoundByKills PROPERTIES PASS_REGULAR_EXPRESSION "kill at byte [0-9]+: o.relievo is neither the old file nor the new one")

  add_custom_target(faults_all
    COMMAND fault_driver --program $<TARGET_FILE:relievo> --library $<TARGET_FILE:relievo_faults>
    COMMAND fault_driver --program $<TARGET_FILE:relievo> --library $<TARGET_FILE:relievo_faults> --kills 200
    COMMAND fault_driver --program $<TARGET_FILE:relievo> --library $<TARGET_FILE:relievo_faults> --kills 200 --resume
    DEPENDS relievo relievo_faults fault_driver USES_TERMINAL)
endif()
