# kiln_bake(): containers built by kiln pipelines, as part of a CMake build.
#
#   execute_process(COMMAND kiln cmake-module OUTPUT_FILE ${CMAKE_BINARY_DIR}/kiln.cmake)
#   include(${CMAKE_BINARY_DIR}/kiln.cmake)
#   kiln_bake(TARGET assets PIPELINE assets/pot.toml OUTPUTS build/pot.kiln [ARGS --backend cpu])
#
# TARGET is a custom target, part of `all`. OUTPUTS are the containers that the pipeline writes, relative to the pipeline's folder.
# kiln says by a depfile what was read: a changed texture alone starts it, and it builds again what that texture reaches.
cmake_minimum_required(VERSION 3.20)

if(NOT KILN_EXECUTABLE)
  find_program(KILN_EXECUTABLE kiln REQUIRED)
endif()

function(kiln_bake)
  cmake_parse_arguments(PARSE_ARGV 0 KILN "" "TARGET;PIPELINE" "OUTPUTS;ARGS")
  foreach(needed TARGET PIPELINE OUTPUTS)
    if(NOT KILN_${needed})
      message(FATAL_ERROR "kiln_bake: ${needed} is missing")
    endif()
  endforeach()
  get_filename_component(pipeline "${KILN_PIPELINE}" ABSOLUTE)
  get_filename_component(folder "${pipeline}" DIRECTORY)
  set(outputs "")
  foreach(output IN LISTS KILN_OUTPUTS)
    get_filename_component(output "${output}" ABSOLUTE BASE_DIR "${folder}")
    list(APPEND outputs "${output}")
  endforeach()
  set(depfile "${CMAKE_CURRENT_BINARY_DIR}/${KILN_TARGET}.d")
  # kiln leaves an output alone that would not change. Ninja knows (`restat`); to Make it would look older than its inputs for ever.
  set(touch "")
  if(CMAKE_GENERATOR MATCHES "Make")
    set(touch COMMAND "${CMAKE_COMMAND}" -E touch ${outputs})
  endif()
  add_custom_command(
    OUTPUT ${outputs}
    COMMAND "${KILN_EXECUTABLE}" build "${pipeline}" --depfile "${depfile}" ${KILN_ARGS}
    ${touch}
    DEPENDS "${pipeline}"
    DEPFILE "${depfile}"
    COMMENT "kiln ${KILN_PIPELINE}"
    VERBATIM)
  add_custom_target(${KILN_TARGET} ALL DEPENDS ${outputs})
endfunction()
