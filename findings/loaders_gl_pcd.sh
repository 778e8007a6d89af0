#!/bin/bash
# @loaders.gl/pcd 4.4.2 (the point clouds of deck.gl), PCDLoader: no intensity comes out of any PCD file, coordinates
# in double precision come out as other numbers, red and blue change places.
#
# The loader is documented to read ascii, binary and compressed binary files; THREE.js' loader, of which it is a copy,
# reads the intensity, both precisions and the colour of all three. Here the intensity of a binary file becomes an
# empty COLOR_0, that of an ascii file nothing. A file whose header says SIZE 8 (a registered survey, or numpy's
# float64 handed over as it was) is read four bytes at a place: x is the lower half of the double. Round metres come
# out as 0, others as numbers anywhere within the range of floats. Of a colour, which PCD packs as 0xRRGGBB, the
# lowest byte is taken for red; in compressed files it is divided by 255 besides and cut to 0 or 1. OPV2V and Open3D
# keep an intensity as a red or grey colour: it comes out in blue, or black. Nothing is said, and the count of points
# is right. Pull request 3101 of visgl/loaders.gl, about the colours, is from 2024.
#
# Way out: PCDLoader of three, or a format of your own (Arrow, float32 in an ArrayBuffer).
#
# Seen (2026-11-30, Node.js 20), one point at 1.1, 2.2, 3.3 m with an intensity of 0.25, or of the colour 255, 128, 0:
# three 0.187.0, loaders.gl
#     intensity, ascii: 0.25, none
#     intensity, binary: 0.25, none
#     intensity, binary_compressed: 0.25, none
#     float64, ascii: 1.1 2.2 3.3, 1.1 2.2 3.3
#     float64, binary: 1.1 2.2 3.3, -1.6e-23 -1.6e-23 2.7e+23
#     float64, binary_compressed: 1.1 2.2 3.3, -1.6e-23 -1.6e-23 2.7e+23
#     rgb, binary: 255 128 0, 0 128 255
#     rgb, binary_compressed: 255 128 0, 0 0 1
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
# @math.gl/types is missing among the dependencies that @loaders.gl/schema-utils 4.4.2 declares.
npm install three@0.187.0 @loaders.gl/core@4.4.2 @loaders.gl/pcd@4.4.2 @math.gl/types@4.1.0 --silent --no-audit --no-fund
cat >look.mjs <<'JAVASCRIPT'
import { parseSync } from "@loaders.gl/core";
import { PCDLoader } from "@loaders.gl/pcd";
import { PCDLoader as ThreeLoader } from "three/examples/jsm/loaders/PCDLoader.js";

const PLACE = [1.1, 2.2, 3.3];
const CASES = {
  intensity: { fields: "x y z intensity", bits: [32, 32, 32, 32], types: "F F F F", values: [...PLACE, 0.25] },
  float64: { fields: "x y z", bits: [64, 64, 64], types: "F F F", values: PLACE },
  rgb: { fields: "x y z rgb", bits: [32, 32, 32, 32], types: "F F F U", values: [...PLACE, 0xff8000] },
};

// A stretch of LZF that holds up to 32 bytes as they are: their count less one, and the bytes.
function lzf(bytes) {
  const packed = [];
  for (let k = 0; k < bytes.length; k += 32) {
    const part = bytes.slice(k, k + 32);
    packed.push(part.length - 1, ...part);
  }
  const sizes = new Uint8Array(new Uint32Array([packed.length, bytes.length]).buffer);
  return Uint8Array.from([...sizes, ...packed]);
}

// A file of one point, for which binary and compressed files have the same order.
function file({ fields, bits, types, values }, data) {
  const ones = bits.map(() => 1).join(" ");
  const lines = ["VERSION 0.7", `FIELDS ${fields}`, `SIZE ${bits.map((n) => n / 8).join(" ")}`, `TYPE ${types}`];
  lines.push(`COUNT ${ones}`, "WIDTH 1", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0", "POINTS 1", `DATA ${data}\n`);
  const view = new DataView(new ArrayBuffer(bits.reduce((sum, n) => sum + n, 0) / 8));
  let at = 0;
  values.forEach((value, k) => {
    if (types.split(" ")[k] === "U") view.setUint32(at, value, true);
    else view[`setFloat${bits[k]}`](at, value, true);
    at += bits[k] / 8;
  });
  const raw = new Uint8Array(view.buffer);
  const body = {
    ascii: new TextEncoder().encode(`${values.join(" ")}\n`),
    binary: raw,
    binary_compressed: lzf(raw),
  }[data];
  return Uint8Array.from([...new TextEncoder().encode(lines.join("\n")), ...body]).buffer;
}

const few = (values) => Array.from(values, (value) => Number(value.toPrecision(2))).join(" ");
const bytes = (values) => Array.from(values, Math.round).join(" ");

function byThree(name, buffer) {
  const { position, intensity, color } = new ThreeLoader().parse(buffer).geometry.attributes;
  if (name === "intensity") return few(intensity.array);
  if (name === "float64") return few(position.array);
  // three hands colours over as linear light
  const srgb = (c) => 255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055);
  return bytes(Array.from(color.array, srgb));
}

function byLoaders(name, buffer) {
  const { attributes } = parseSync(buffer, PCDLoader);
  if (name === "float64") return few(attributes.POSITION.value);
  if (name === "rgb") return bytes(attributes.COLOR_0.value);
  const others = Object.entries(attributes).filter(([key]) => key !== "POSITION");
  return others.map(([, { value }]) => few(value)).join(" ") || "none";
}

const found = {};
for (const name of Object.keys(CASES)) {
  for (const data of ["ascii", "binary", "binary_compressed"]) {
    if (name === "rgb" && data === "ascii") continue;
    const buffer = file(CASES[name], data);
    found[`${name}, ${data}`] = [byThree(name, buffer), byLoaders(name, buffer)];
    console.log(`${name}, ${data}: ${found[`${name}, ${data}`].join(", ")}`);
  }
}
const seen = {
  "intensity, ascii": ["0.25", "none"],
  "intensity, binary": ["0.25", "none"],
  "intensity, binary_compressed": ["0.25", "none"],
  "float64, ascii": ["1.1 2.2 3.3", "1.1 2.2 3.3"],
  "float64, binary": ["1.1 2.2 3.3", "-1.6e-23 -1.6e-23 2.7e+23"],
  "float64, binary_compressed": ["1.1 2.2 3.3", "-1.6e-23 -1.6e-23 2.7e+23"],
  "rgb, binary": ["255 128 0", "0 128 255"],
  "rgb, binary_compressed": ["255 128 0", "0 0 1"],
};
const asSeen = JSON.stringify(found) === JSON.stringify(seen);
console.log(asSeen ? "as seen" : "changed");
process.exit(asSeen ? 0 : 1);
JAVASCRIPT
node look.mjs
