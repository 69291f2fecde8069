# Writes the text file INPUT into OUTPUT as pleat::presentation::viewer_template(). Raw string literals compile in no time, where an
# array of 700,000 numbers takes half a minute; the delimiter must not occur in the text.
file(READ ${INPUT} text)
string(FIND "${text}" ")PLEAT_VIEWER\"" clash)
if(NOT clash EQUAL -1)
  message(FATAL_ERROR "${INPUT} contains the delimiter of the raw string")
endif()
file(WRITE ${OUTPUT} "// Made from viewer.html by embed.cmake.\n#include \"services/presentation/report/viewer_template.hpp\"\n\nnamespace pleat::presentation {\n\nstd::string_view viewer_template() {\n  static constexpr char kText[] = R\"PLEAT_VIEWER(")
file(APPEND ${OUTPUT} "${text}")
file(APPEND ${OUTPUT} ")PLEAT_VIEWER\";\n  return {kText, sizeof(kText) - 1};\n}\n\n}  // namespace pleat::presentation\n")
