#include "common/base/manual.hpp"

#include <algorithm>
#include <string_view>

#include "common/base/whole_file.hpp"

namespace pleat {
namespace {

namespace fs = std::filesystem;

bool is_group(const CLI::App& app) { return app.get_name().empty(); }

std::string upper(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::toupper(c); });
  return text;
}

std::string replaced(std::string text, std::string_view what, std::string_view with) {
  for (std::size_t at = 0; (at = text.find(what, at)) != std::string::npos; at += with.size())
    text.replace(at, what.size(), with);
  return text;
}

/// Text for man(7): no escape sequences, no requests.
std::string roff(const std::string& text) {
  std::string safe;
  bool line_start = true;
  for (const char c : text) {
    if (line_start && (c == '.' || c == '\'')) safe += "\\&";
    line_start = c == '\n';
    if (c == '\\')
      safe += "\\e";
    else if (c == '-')
      safe += "\\-";
    else if (c == '`')
      safe += "\\(ga";
    else if (c == '\'')
      safe += "\\(aq";
    else
      safe += c;
  }
  return safe;
}

bool takes_value(const CLI::Option& option) { return option.get_items_expected_max() > 0; }

/// "TEXT" of "TEXT:{a,b}" and of "TEXT:> 0".
std::string value_name(const CLI::Option& option) {
  const std::string type = option.get_type_name();
  return type.empty() ? "VALUE" : type.substr(0, type.find(':'));
}

std::string flag_names(const CLI::Option& option) {
  std::string names;
  for (const std::string& name : option.get_snames()) names += (names.empty() ? "-" : ", -") + name;
  for (const std::string& name : option.get_lnames()) names += (names.empty() ? "--" : ", --") + name;
  return names;
}

std::string sentence(const CLI::Option& option) {
  std::string text = option.get_description();
  if (const auto values = choices(option); !values.empty() && text.find(values.front()) == std::string::npos) {
    text += " (";
    for (std::size_t i = 0; i < values.size(); ++i) text += (i > 0 ? ", " : "") + values[i];
    text += ")";
  }
  if (const std::string standard = option.get_default_str(); !standard.empty()) text += " [" + standard + "]";
  if (const std::string variable = option.get_envname(); !variable.empty()) text += "; environment: " + variable;
  return text;
}

struct Path {
  const CLI::App* app;
  std::vector<std::string> words;  ///< without the program's name
};

void collect(const CLI::App& app, const std::vector<std::string>& words, std::vector<Path>& paths) {
  paths.push_back({&app, words});
  for (const CLI::App* command : visible_commands(app)) {
    std::vector<std::string> deeper = words;
    deeper.push_back(command->get_name());
    collect(*command, deeper, paths);
  }
}

std::string joined(const std::vector<std::string>& words, const std::string& between) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : between) + word;
  return text;
}

std::string page(const CLI::App& root, const Path& path, const std::string& version) {
  const std::string& program = root.get_name();
  const std::string spaced = program + (path.words.empty() ? "" : " ") + joined(path.words, " ");
  const std::string name = replaced(spaced, " ", "-");
  const auto options = visible_options(*path.app);
  const auto commands = visible_commands(*path.app);
  std::string text = ".TH " + upper(name) + " 1 \"\" \"" + roff("Pleat " + version) + "\" Pleat\n.SH NAME\n" +
                     roff(name) + " \\- " + roff(path.app->get_description()) + "\n.SH SYNOPSIS\n.B " + roff(spaced) +
                     "\n";
  if (!options.empty()) text += "[\\fIOPTIONS\\fR]\n";
  if (!commands.empty()) text += "\\fICOMMAND\\fR\n";
  for (const CLI::Option* option : options) {
    if (!option->get_positional()) continue;
    std::string word = "\\fI" + roff(upper(option->get_name())) + "\\fR";
    if (option->get_items_expected_max() > 1) word += "...";
    text += (option->get_required() ? word : "[" + word + "]") + "\n";
  }
  if (!commands.empty()) {
    text += ".SH COMMANDS\n";
    for (const CLI::App* command : commands)
      text += ".TP\n.BR " + roff(name + "-" + command->get_name()) + " (1)\n" + roff(command->get_description()) + "\n";
  }
  std::string arguments, flags;
  for (const CLI::Option* option : options) {
    if (option->get_positional())
      arguments += ".TP\n\\fI" + roff(upper(option->get_name())) + "\\fR\n" + roff(sentence(*option)) + "\n";
    else
      flags += ".TP\n\\fB" + roff(flag_names(*option)) + "\\fR" +
               (takes_value(*option) ? " \\fI" + roff(value_name(*option)) + "\\fR" : "") + "\n" +
               roff(sentence(*option)) + "\n";
  }
  if (!arguments.empty()) text += ".SH ARGUMENTS\n" + arguments;
  if (!flags.empty()) text += ".SH OPTIONS\n" + flags;
  if (const std::string footer = path.app->get_footer(); !footer.empty())
    text += ".SH NOTES\n.nf\n" + roff(footer) + "\n.fi\n";
  text += ".SH EXIT STATUS\n0: done; 1: failed; 2: wrong usage or input.\n";
  if (!path.words.empty()) text += ".SH SEE ALSO\n.BR " + roff(program) + " (1)\n";
  return text;
}

/// A word for a shell between single quotes.
std::string shell_word(const std::string& text) { return "'" + replaced(text, "'", "'\\''") + "'"; }

std::string identifier(const std::string& name) { return replaced(name, "-", "_"); }

std::vector<std::string> flag_words(const CLI::Option& option) {
  std::vector<std::string> words;
  for (const std::string& name : option.get_lnames()) words.push_back("--" + name);
  for (const std::string& name : option.get_snames()) words.push_back("-" + name);
  return words;
}

std::vector<std::string> command_names(const CLI::App& app) {
  std::vector<std::string> names;
  for (const CLI::App* command : visible_commands(app)) names.push_back(command->get_name());
  return names;
}

std::string bash(const CLI::App& root, const std::vector<Path>& paths) {
  std::string words, flags, values;
  for (const Path& path : paths) {
    const std::string key = joined(path.words, " ");
    std::vector<std::string> commands = command_names(*path.app), names;
    if (path.words.empty() && !commands.empty()) commands.emplace_back("help");
    if (!commands.empty()) words += "    " + shell_word(key) + ") words=" + shell_word(joined(commands, " ")) + " ;;\n";
    for (const CLI::Option* option : visible_options(*path.app)) {
      const auto own = flag_words(*option);
      names.insert(names.end(), own.begin(), own.end());
      if (own.empty() || !takes_value(*option)) continue;
      std::vector<std::string> patterns;
      patterns.reserve(own.size());
      for (const std::string& word : own) patterns.push_back(shell_word(key + " " + word));
      values += "    " + joined(patterns, "|") + ") values=" + shell_word(joined(choices(*option), " ")) + " ;;\n";
    }
    flags += "    " + shell_word(key) + ") flags=" + shell_word(joined(names, " ")) + " ;;\n";
  }
  const std::string name = "_" + identifier(root.get_name());
  return "# bash completion for " + root.get_name() + "; made from its own description.\n" + name +
         "() {\n"
         "  local current=${COMP_WORDS[COMP_CWORD]} previous=${COMP_WORDS[COMP_CWORD-1]} path='' word words='' "
         "flags='' "
         "values=- i\n"
         "  COMPREPLY=()\n"
         "  for ((i = 1; i < COMP_CWORD; i++)); do\n"
         "    word=${COMP_WORDS[i]}\n"
         "    [[ $i == 1 && $word == help ]] && continue\n"
         "    words=''\n"
         "    case \"$path\" in\n" +
         words +
         "    esac\n"
         "    [[ \" $words \" == *\" $word \"* ]] && path=\"${path:+$path }$word\"\n"
         "  done\n"
         "  words=''\n"
         "  case \"$path\" in\n" +
         words + "  esac\n  case \"$path\" in\n" + flags + "  esac\n  case \"$path $previous\" in\n" +
         (values.empty() ? "    *) ;;\n" : values) +
         "  esac\n"
         "  if [[ $values != - ]]; then\n"
         "    [[ $values ]] && COMPREPLY=($(compgen -W \"$values\" -- \"$current\"))\n"
         "  elif [[ $current == -* ]]; then\n"
         "    COMPREPLY=($(compgen -W \"$flags\" -- \"$current\"))\n"
         "  elif [[ $words ]]; then\n"
         "    COMPREPLY=($(compgen -W \"$words\" -- \"$current\"))\n"
         "  fi\n"
         "}\n"
         "complete -o bashdefault -o default -F " +
         name + " " + root.get_name() + "\n";
}

/// Inside [...] and between colons of _arguments.
std::string zsh_text(std::string text) {
  for (const char* special : {"\\", "[", "]", ":"}) text = replaced(text, special, std::string("\\") + special);
  return text;
}

std::string zsh(const CLI::App& root, const std::vector<Path>& paths) {
  const auto function = [&](const Path& path) {
    std::string name = "_" + root.get_name();
    for (const std::string& word : path.words) name += "_" + word;
    return identifier(name);
  };
  std::string text = "#compdef " + root.get_name() + "\n# Made from the program's own description.\n";
  for (const Path& path : paths) {
    text += function(path) + "() {\n";
    const auto commands = visible_commands(*path.app);
    text += commands.empty() ? "  _arguments -S" : "  local line state\n  _arguments -C";
    for (const CLI::Option* option : visible_options(*path.app)) {
      std::string value;
      if (takes_value(*option)) {
        const auto values = choices(*option);
        value =
            ":" + zsh_text(value_name(*option)) + ":" + (values.empty() ? "_files" : "(" + joined(values, " ") + ")");
      }
      for (const std::string& word : flag_words(*option))
        text += " \\\n    " + shell_word(word + "[" + zsh_text(option->get_description()) + "]" + value);
      if (option->get_positional())
        text += " \\\n    " +
                shell_word(std::string(option->get_items_expected_max() > 1 ? "*" : "") + ":" +
                           zsh_text(option->get_name()) + (value.empty() ? ":_files" : value.substr(value.rfind(':'))));
    }
    if (!commands.empty()) {
      text += " \\\n    '1: :->command' '*:: :->rest'\n  case $state in\n    command)\n      local -a commands=(";
      for (const CLI::App* command : commands)
        text += "\n        " + shell_word(zsh_text(command->get_name()) + ":" + command->get_description());
      text += ")\n      _describe command commands ;;\n    rest)\n      case $line[1] in\n";
      for (const CLI::App* command : commands) {
        Path deeper = path;
        deeper.words.push_back(command->get_name());
        text += "        " + command->get_name() + ") " + function(deeper) + " ;;\n";
      }
      text += "      esac ;;\n  esac";
    }
    text += "\n}\n";
  }
  const std::string name = function(paths.front());
  return text + "if [ \"$funcstack[1]\" = " + shell_word(name) + " ]; then " + name + " \"$@\"; else compdef " + name +
         " " + root.get_name() + "; fi\n";
}

std::string fish(const CLI::App& root, const std::vector<Path>& paths) {
  const std::string start = "complete -c " + root.get_name();
  std::string text = "# fish completion for " + root.get_name() + "; made from its own description.\n";
  for (const Path& path : paths) {
    std::string condition;
    for (const std::string& word : path.words)
      condition += (condition.empty() ? "" : "; and ") + ("__fish_seen_subcommand_from " + word);
    const auto commands = visible_commands(*path.app);
    if (!commands.empty()) {
      const std::string none = "not __fish_seen_subcommand_from " + joined(command_names(*path.app), " ");
      condition += (condition.empty() ? "" : "; and ") + none;
    }
    const std::string when = condition.empty() ? "" : " -n " + shell_word(condition);
    for (const CLI::App* command : commands)
      text += start + when + " -f -a " + command->get_name() + " -d " + shell_word(command->get_description()) + "\n";
    for (const CLI::Option* option : visible_options(*path.app)) {
      std::string names;
      for (const std::string& name : option->get_lnames()) names += " -l " + name;
      for (const std::string& name : option->get_snames()) names += " -s " + name;
      if (names.empty()) continue;
      const auto values = choices(*option);
      text += start + when + names + (takes_value(*option) ? " -r" : "") +
              (values.empty() ? "" : " -f -a " + shell_word(joined(values, " "))) + " -d " +
              shell_word(option->get_description()) + "\n";
    }
  }
  return text;
}

}  // namespace

std::vector<const CLI::Option*> visible_options(const CLI::App& app) {
  std::vector<const CLI::Option*> options =
      app.get_options([](const CLI::Option* option) { return !option->get_group().empty(); });
  for (const CLI::App* group : app.get_subcommands([](const CLI::App* part) { return is_group(*part); })) {
    const auto own = visible_options(*group);
    options.insert(options.end(), own.begin(), own.end());
  }
  return options;
}

std::vector<const CLI::App*> visible_commands(const CLI::App& app) {
  return app.get_subcommands(
      [](const CLI::App* command) { return !is_group(*command) && !command->get_group().empty(); });
}

std::vector<std::string> choices(const CLI::Option& option) {
  const std::string type = option.get_type_name();
  const std::size_t begin = type.find('{'), end = type.find('}');
  std::vector<std::string> values;
  if (begin == std::string::npos || end == std::string::npos) return values;
  for (std::size_t at = begin + 1; at < end;) {
    const std::size_t comma = std::min(type.find(',', at), end);
    values.push_back(type.substr(at, comma - at));
    at = comma + 1;
  }
  return values;
}

std::vector<ManualFile> manual(const CLI::App& root, const std::string& version) {
  std::vector<Path> paths;
  collect(root, {}, paths);
  std::vector<ManualFile> files;
  const std::string& name = root.get_name();
  for (const Path& path : paths) {
    const std::string stem = name + (path.words.empty() ? "" : "-") + joined(path.words, "-");
    files.push_back({"man/man1/" + stem + ".1", page(root, path, version)});
  }
  files.push_back({"bash-completion/completions/" + name, bash(root, paths)});
  files.push_back({"zsh/site-functions/_" + name, zsh(root, paths)});
  files.push_back({"fish/vendor_completions.d/" + name + ".fish", fish(root, paths)});
  return files;
}

void write_manual(const CLI::App& root, const std::string& version, const fs::path& folder) {
  for (const ManualFile& file : manual(root, version)) write_whole_file(folder / file.path, file.text);
}

fs::path manual_folder(int argc, const char* const* argv) {
  return argc == 3 && std::string_view(argv[1]) == "--write-manual" ? argv[2] : "";
}

}  // namespace pleat
