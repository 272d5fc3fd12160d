// Asks the search of the built site what users ask, and ends with 1 where another page comes first than one of those that
// answer: node docs/questions.js [SITE] (after `python3 dev.py docs`; -v shows the first three pages of each).
const fs = require("fs"), path = require("path");
const [site] = process.argv.slice(2).filter((word) => word !== "-v");
const folder = path.resolve(site || path.join(__dirname, "..", "site"), "search");
const lunr = require(path.join(folder, "lunr.js"));
const { docs } = JSON.parse(fs.readFileSync(path.join(folder, "search_index.json"), "utf8"));
const QUESTIONS = {
  "torque constant": ["gains"],
  "motor current": ["gains"],
  "gear ratio": ["gains"],
  "no torque sensor": ["servo", "gains"],
  "time offset": ["methods_choices"],
  "base tilt": ["methods_choices"],
  "export to MuJoCo": ["export"],
  "Isaac Lab": ["export"],
  "payload": ["payload"],
  "friction with load": ["configuration", "methods_model"],
  "log in degrees": ["robots"],
  "record a motion": ["experiment"],
  "URScript": ["experiment"],
  "Franka": ["recipes"],
  "ROS bag": ["recipes", "supported"],
  "standard error": ["methods_errors"],
  "base parameters": ["methods_estimation", "notation"],
  "which estimator": ["choosing"],
  "feedforward": ["tutorial"],
  "install": ["supported"],
};
// by the site's own worker, in place of the browser's
const worker = fs.readFileSync(path.join(folder, "worker.js"), "utf8");
global.importScripts = () => {};
Object.assign(global, { lunr, postMessage: () => {}, XMLHttpRequest: class {} });
const search = new Function(`${worker}; onJSONLoaded.call({ responseText: ${JSON.stringify(JSON.stringify({ config: {}, docs }))} });
return search;`)();
const titles = Object.fromEntries(docs.map((doc) => [doc.location, doc.title]));
let wrong = 0;
for (const [question, pages] of Object.entries(QUESTIONS)) {
  const found = search(question).map(({ location }) => location);
  const first = (found[0] || "").replace(/^docs\/|\.html.*$/g, "");
  if (!pages.includes(first)) wrong += 1;
  if (process.argv.includes("-v") || !pages.includes(first)) {
    const shown = found.slice(0, 3).map((ref) => `${ref} (${titles[ref]})`);
    console.log(`${pages.includes(first) ? "right" : "WRONG"}: ${question}\n  ${shown.join("\n  ")}`);
  }
}
console.log(`${Object.keys(QUESTIONS).length - wrong} of ${Object.keys(QUESTIONS).length} questions have the right page first.`);
process.exit(wrong ? 1 : 0);
