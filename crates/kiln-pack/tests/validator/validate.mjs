// Runs Khronos' glTF validator over GLB files: one JSON line a file, exit 1 if any has an error.
//
//   node validate.mjs FOLDER FILE.glb...
//
// FOLDER is one in which `npm install gltf-validator` was run.

import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { resolve } from 'node:path';

const [folder, ...files] = process.argv.slice(2);
const validator = createRequire(resolve(folder, 'package.json'))('gltf-validator');
let failed = files.length === 0;
for (const file of files) {
    const report = await validator.validateBytes(new Uint8Array(readFileSync(file)), { maxIssues: 100 });
    const { numErrors, numWarnings, numInfos, messages } = report.issues;
    const worst = messages.filter((m) => m.severity < 2).slice(0, 10).map((m) => `${m.code} ${m.pointer}: ${m.message}`);
    console.log(JSON.stringify({ file: file.split('/').pop(), errors: numErrors, warnings: numWarnings, infos: numInfos, worst }));
    failed ||= numErrors > 0;
}
process.exit(failed ? 1 : 0);
