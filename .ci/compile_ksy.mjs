// Compiles a Kaitai Struct description to Python with Kaitai's compiler; any output is an error.
//
//   node .ci/compile_ksy.mjs MODULES KSY OUT
//
// MODULES is the node_modules folder with kaitai-struct-compiler and yaml.
import { createRequire } from "node:module";
import { readFileSync, writeFileSync } from "node:fs";
import { join, resolve } from "node:path";

const [modules, description, out] = process.argv.slice(2);
const require = createRequire(join(resolve(modules), "none.js"));
const compiler = require("kaitai-struct-compiler");

const warnings = [];
for (const level of ["log", "warn", "error"]) console[level] = (...words) => warnings.push(words.join(" "));

const files = await compiler.compile("python", require("yaml").parse(readFileSync(description, "utf8")), null, false);
for (const [name, text] of Object.entries(files)) writeFileSync(join(out, name), text);
if (warnings.length) {
    process.stderr.write(warnings.join("\n") + "\n");
    process.exit(1);
}
