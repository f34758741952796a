// node validate.mjs FILE.glb...   one line a file: errors, warnings; exit 1 where a file has an error.
import { readFile } from "node:fs/promises";
import { basename } from "node:path";
import { validateBytes } from "gltf-validator";

let failed = false;
for (const file of process.argv.slice(2)) {
  const report = await validateBytes(new Uint8Array(await readFile(file)), { uri: basename(file), maxIssues: 1000 });
  const { numErrors, numWarnings, messages } = report.issues;
  console.log(`${basename(file)}: ${numErrors} errors, ${numWarnings} warnings`);
  for (const issue of messages.filter((m) => m.severity === 0).slice(0, 20)) {
    console.log(`  ${issue.code} ${issue.pointer ?? ""} ${issue.message}`);
  }
  failed ||= numErrors > 0;
}
process.exitCode = failed ? 1 : 0;
