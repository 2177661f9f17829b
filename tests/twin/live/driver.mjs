// A simulated arm in another language, made from cell.proto alone.
// Usage: node driver.mjs CELL_PROTO ADDRESS ROBOT PACE [DIR_OF_MODULES]
import { createRequire } from "node:module";

const [proto, address, robot, pace, modules] = process.argv.slice(2);
const load = createRequire(modules + "/");
const grpc = load("@grpc/grpc-js");
const options = { keepCase: true, longs: Number, defaults: true };
const parsed = load("@grpc/proto-loader").loadSync(proto, options);
const { Cell } = grpc.loadPackageDefinition(parsed).assembly_twin;
const cell = new Cell(address, grpc.credentials.createInsecure());
await new Promise((ready, failed) =>
  cell.waitForReady(Date.now() + 20000, (error) => (error ? failed(error) : ready())),
);
const stream = cell.Drive();

const seconds = () => Number(process.hrtime.bigint()) / 1e9;
const instance = Date.now();
let session = "", number = 0, seen = 0, version = 0, have = 0, done = 0, left = false;
let again = 0, kept = 0, told = 0, q = [], nodes = [], gone = 0, at = seconds(), samples = [];
let ordered = "", actedAt = Infinity;

function sample(time, begun) {
  samples.push({ at_s: time, q, begun, done });
}

// Straight on from waypoint to waypoint, in the times that the node has for them.
function position(node, passed) {
  let before = node.from, since = 0;
  for (let k = 0; k < node.seconds.length; k++) {
    const to = node.waypoints.slice(k * before.length, (k + 1) * before.length);
    if (passed <= node.seconds[k]) {
      const part = (passed - since) / Math.max(node.seconds[k] - since, 1e-9);
      return before.map((a, i) => a + part * (to[i] - a));
    }
    [before, since] = [to, node.seconds[k]];
  }
  return before;
}

function advance() {
  const now = seconds();
  let time = (now - at) * pace;
  at = now;
  while (nodes.length && time > 0) {
    const node = nodes[0], whole = node.seconds[node.seconds.length - 1];
    if (gone === 0) sample(now - time / pace, done + 1);
    for (const passed of node.seconds.slice(0, -1))
      if (gone < passed && passed < gone + time) {
        time -= passed - gone;
        gone = passed;
        q = position(node, gone);
        sample(now - time / pace, done + 1);
      }
    if (gone + time < whole) {
      gone += time;
      q = position(node, gone);
      return;
    }
    time -= whole - gone;
    gone = 0;
    q = position(node, whole);
    nodes.shift();
    done += 1;
    sample(now - time / pace, done);
  }
}

stream.on("data", (command) => {
  if (command.robot !== robot || command.instance !== instance) return;
  if (left || command.number <= seen) return;
  if (session && session !== command.session) return;
  if (!session) {
    session = command.session;
    q = command.start;
    have = done = command.done;
    at = seconds();
  }
  seen = command.number;
  if (command.heard === 0) told = kept;
  while (samples.length && kept < command.heard) {
    samples.shift();
    kept += 1;
  }
  advance();
  for (const node of command.nodes) {
    if (node.node !== have) continue;
    const last = nodes.length ? nodes[nodes.length - 1] : null;
    node.from = last ? last.waypoints.slice(-q.length) : q;
    nodes.push(node);
    have += 1;
  }
  if (command.tool && command.tool.name !== ordered) {
    ordered = command.tool.name;
    actedAt = seconds() + command.tool.seconds / pace;
  }
  version = Math.max(version, command.version);
  left = command.leave;
});

const timer = setInterval(() => {
  advance();
  const begun = done + (gone > 0 ? 1 : 0);
  const acted = at >= actedAt ? ordered : "";
  if (session) sample(at, begun);
  number += 1;
  if (at - again > 0.5) [told, again] = [kept, at];
  const first = Math.max(told, kept);
  const fresh = samples.slice(first - kept);
  told = kept + samples.length;
  stream.write({
    session, robot, instance, number, at_s: at, seen, version, have, begun, done,
    mode: nodes.length ? "moving" : "standing", q, dq: q.map(() => 0), samples: fresh, first, kept, acted,
  });
  if (left) {
    clearInterval(timer);
    stream.end();
  }
}, Math.max(20 / pace, 2));
stream.on("error", (error) => {
  console.error(error.details);
  process.exit(1);
});
