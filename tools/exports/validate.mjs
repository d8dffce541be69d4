// Khronos' validator over GLB and VRM files: `node validate.mjs FILE …`, one line of JSON each.
import fs from "node:fs";
import { createRequire } from "node:module";
const validator = createRequire(process.cwd() + "/")("gltf-validator");
for (const path of process.argv.slice(2)) {
  const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(path)), { uri: path, maxIssues: 100 });
  const { numErrors, numWarnings, numInfos, numHints, messages } = report.issues;
  const codes = {};
  for (const { code, severity } of messages) codes[`${severity} ${code}`] = (codes[`${severity} ${code}`] || 0) + 1;
  console.log(JSON.stringify({ numErrors, numWarnings, numInfos, numHints, codes, messages: messages.slice(0, 3) }));
}
