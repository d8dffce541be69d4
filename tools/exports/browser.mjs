// Exports in headless Chromium: `node browser.mjs glb|vrm|html FILE PICTURES TASKS.json`. Prints one line of JSON.
//
// Needs puppeteer-core and, for GLB and VRM, page.bundle.js (page.js by esbuild) in the current folder.
import fs from "node:fs";
import { createRequire } from "node:module";
const puppeteer = createRequire(process.cwd() + "/")("puppeteer-core");
const [kind, file, pictures, tasks] = process.argv.slice(2);
const flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"];
const browser = await puppeteer.launch({ executablePath: process.env.CHROMIUM || "/usr/bin/chromium", args: flags, protocolTimeout: 300000 });
const page = await browser.newPage();
const problems = [];
page.on("console", (message) => ["error", "warn"].includes(message.type()) && problems.push(message.text()));
page.on("pageerror", (error) => problems.push(String(error)));
const answer = {};

async function three() {
  await page.setViewport({ width: 512, height: 640 });
  await page.goto("about:blank");
  await page.addScriptTag({ path: "page.bundle.js" });
  await page.evaluate((data, vrm) => window.load(data, vrm), fs.readFileSync(file).toString("base64"), kind === "vrm");
  answer.facts = await page.evaluate(() => window.facts());
  answer.vertices = {};
  for (const task of JSON.parse(tasks)) {
    await page.evaluate((what) => window.show(what), task);
    await page.screenshot({ path: `${pictures}/${kind}_${task.name}.png` });
    if (task.every) answer.vertices[task.name] = await page.evaluate((every) => window.vertices(every), task.every);
  }
}

async function html() {
  await page.setViewport({ width: 1100, height: 720 });
  await page.goto(`file://${file}`);
  await page.waitForSelector("body[data-ready]", { timeout: 120000 });
  await page.select("#clip", "");
  const shot = async (name) => {
    await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
    await page.screenshot({ path: `${pictures}/html_${name}.png` });
  };
  const slide = (name, value) =>
    page.$eval(`input[name="${name}"]`, (input, to) => {
      input.value = to;
      input.dispatchEvent(new Event("input"));
    }, value);
  await shot("rest");
  await slide("left_shoulder.z", -65);
  await shot("joint");
  await page.click("#face");
  await shot("face_rest");
  await slide("jawOpen", 1);
  await slide("mouthSmileLeft", 1);
  await shot("face_moved");
  await page.click("#reset");
  await page.click("#whole");
  const clips = await page.$$eval("#clip option", (options) => options.map((option) => option.value));
  await page.select("#clip", clips[1]);
  await page.$eval("#time", (input) => {
    input.value = 0.3;
    input.dispatchEvent(new Event("input"));
  });
  await shot("clip");
  answer.facts = { clips, sliders: await page.$$eval("#expressions input", (inputs) => inputs.length) };
}

await (kind === "html" ? html() : three());
await browser.close();
console.log(JSON.stringify({ ...answer, problems }));
