// Manifests against the schemas of Kubernetes' API: FILE.yaml... The validators find what is missing or of the wrong type, the types
// of the same schemas members that do not exist. Prints what is wrong, a line each; exit code 1.
import fs from "node:fs";
import path from "node:path";
import ts from "typescript";
import YAML from "yaml";

const wrong = [];
let checked = 0;
let typed = "";
const lines = []; // of the typed program -> where the object comes from

for (const file of process.argv.slice(2)) {
  for (const document of YAML.parseAllDocuments(fs.readFileSync(file, "utf8"))) {
    const where = () => `${file}: ${object?.kind} ${object?.metadata?.name}`;
    let object = null;
    if (document.errors.length) {
      wrong.push(`${file}: ${document.errors[0].message}`);
      continue;
    }
    object = document.toJS();
    const group = object.apiVersion === "v1" ? "v1" : object.apiVersion.replace(/^autoscaling\/|^apps\/|^batch\/|^policy\//, (g) => g);
    let model;
    try {
      model = (await import(`kubernetes-models/${group}/${object.kind}`))[object.kind];
    } catch {
      wrong.push(`${where()}: the API has no ${object.kind} in ${object.apiVersion}`);
      continue;
    }
    try {
      new model(object).validate();
    } catch (error) {
      wrong.push(`${where()}: ${error.message}`);
    }
    typed += `{ const o: import("kubernetes-models/${group}/${object.kind}").I${object.kind} = ${JSON.stringify(object)}; void o; }\n`;
    lines.push(where());
    ++checked;
  }
}

const program = path.resolve("typed.ts");
fs.writeFileSync(program, typed + "export {};\n");
const options = { noEmit: true, strict: false, skipLibCheck: true, types: [], module: ts.ModuleKind.Node16,
  moduleResolution: ts.ModuleResolutionKind.Node16, target: ts.ScriptTarget.ES2022 };
for (const found of ts.getPreEmitDiagnostics(ts.createProgram([program], options))) {
  const line = found.file?.fileName === program ? found.file.getLineAndCharacterOfPosition(found.start).line : -1;
  wrong.push(`${lines[line] ?? "types"}: ${ts.flattenDiagnosticMessageText(found.messageText, " ")}`);
}
for (const line of wrong) console.log(line);
console.log(`${checked} objects checked`);
process.exit(wrong.length || !checked ? 1 : 0);
