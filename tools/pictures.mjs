// The part of tools/pictures that needs a browser: composes pictures and photographs the viewer's page in Chromium.
//
// node pictures.mjs PROGRAM DEMO FOLDER
import { execFileSync, spawn } from 'node:child_process';
import { mkdtempSync, readdirSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { createInterface } from 'node:readline';
import { deflateSync } from 'node:zlib';

const [program, demo, folder] = process.argv.slice(2);
const PATIENCE = 120_000;
const COLORS = 256;
/** The held-out view of the pair: its number in the contact sheet. */
const VIEW = 2;
/** Rows of the contact sheet that are shown, and how much smaller. */
const SHEET = { rows: 3, scale: 0.75 };
/** Sizes in which the scene is shown, as shares of the photograph's, and the pixels of each picture. */
const SIZES = { shares: [1 / 8, 1 / 4, 1 / 2, 1, 2], width: 128, height: 96, gap: 6 };
/** The viewer's page, CSS pixels, and how much smaller its picture is. */
const PAGE = { width: 1120, height: 640, scale: 0.75 };

const profile = mkdtempSync(join(tmpdir(), 'ashsplat-pictures-'));
const children = [];
function start(command, args, stdio) {
    const child = spawn(command, args, { stdio });
    child.on('error', (error) => fail(`${command}: ${error.message}`));
    children.push(child);
    return child;
}

function end() {
    for (const child of children) child.kill('SIGKILL');
    try {
        rmSync(profile, { recursive: true, force: true, maxRetries: 5 });
    } catch {
        // A killed browser's own children may still write; it is in the system's temporary folder.
    }
}

function fail(problem) {
    console.error(`pictures: ${problem}`);
    end();
    process.exit(2);
}

setTimeout(() => fail('not finished in time'), PATIENCE).unref();

/** One page in Chromium, by the DevTools protocol over a pipe. */
async function openBrowser() {
    const flags = ['--headless', '--no-sandbox', '--hide-scrollbars', '--remote-debugging-pipe', `--user-data-dir=${profile}`];
    const child = start(process.env.CHROMIUM ?? 'chromium', [...flags, 'about:blank'], ['ignore', 'ignore', 'ignore', 'pipe', 'pipe']);
    const pending = new Map();
    let last = 0, rest = Buffer.alloc(0), session;
    child.stdio[4].on('data', (bytes) => {
        rest = Buffer.concat([rest, bytes]);
        for (let length; (length = rest.indexOf(0)) >= 0; rest = rest.subarray(length + 1)) {
            const { id, result, error } = JSON.parse(rest.subarray(0, length));
            if (error) fail(JSON.stringify(error));
            pending.get(id)?.(result);
            pending.delete(id);
        }
    });
    const call = (method, params = {}) => new Promise((done) => {
        pending.set(++last, done);
        child.stdio[3].write(`${JSON.stringify({ id: last, method, params, sessionId: session })}\0`);
    });
    const { targetId } = await call('Target.createTarget', { url: 'about:blank' });
    session = (await call('Target.attachToTarget', { targetId, flatten: true })).sessionId;
    return call;
}

const call = await openBrowser();
async function evaluate(expression) {
    const { result, exceptionDetails } = await call('Runtime.evaluate', { expression, awaitPromise: true, returnByValue: true });
    if (exceptionDetails) fail(`${exceptionDetails.text} ${exceptionDetails.exception?.description}`);
    return result.value;
}

const pause = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));
async function until(condition) {
    while (!await evaluate(condition)) await pause(100);
}

/** Draws in a canvas of a blank page; its size and RGBA bytes. `images` are PNG files. */
async function draw(files, body) {
    const urls = files.map((bytes) => `data:image/png;base64,${bytes.toString('base64')}`);
    await call('Page.navigate', { url: 'about:blank' });
    const text = await evaluate(`(async () => {
        const images = await Promise.all(${JSON.stringify(urls)}.map(async (url) => {
            const image = new Image();
            image.src = url;
            await image.decode();
            return image;
        }));
        const canvas = document.createElement('canvas');
        const size = (width, height) => {
            Object.assign(canvas, { width: Math.round(width), height: Math.round(height) });
            const context = canvas.getContext('2d');
            context.imageSmoothingQuality = 'high';
            return context;
        };
        (${body})(images, size);
        const { width, height } = canvas;
        const { data } = canvas.getContext('2d').getImageData(0, 0, width, height);
        let text = '';
        for (let i = 0; i < data.length; i += 4096) text += String.fromCharCode(...data.subarray(i, i + 4096));
        return [width, height, btoa(text)];
    })()`);
    return { width: text[0], height: text[1], rgba: Buffer.from(text[2], 'base64') };
}

/** A palette by median cut, and for each pixel the nearest colour's index. */
function quantize({ width, height, rgba }) {
    const bins = new Map();
    const key = (i) => (rgba[i] >> 1) << 14 | (rgba[i + 1] >> 1) << 7 | rgba[i + 2] >> 1;
    for (let i = 0; i < rgba.length; i += 4) {
        const k = key(i);
        const bin = bins.get(k) ?? { n: 0, sum: [0, 0, 0] };
        bin.n += 1;
        for (let c = 0; c < 3; ++c) bin.sum[c] += rgba[i + c];
        bins.set(k, bin);
    }
    const measured = (members) => {
        const n = members.reduce((a, b) => a + b.n, 0);
        const mean = [0, 1, 2].map((c) => members.reduce((a, b) => a + b.sum[c], 0) / n);
        const spread = [0, 1, 2].map((c) => members.reduce((a, b) => a + b.n * (b.sum[c] / b.n - mean[c]) ** 2, 0));
        const axis = spread.indexOf(Math.max(...spread));
        return { members, mean, axis, error: members.length > 1 ? spread[axis] : 0 };
    };
    const boxes = [measured([...bins.values()])];
    while (boxes.length < COLORS) {
        const at = boxes.reduce((best, box, i) => (box.error > boxes[best].error ? i : best), 0);
        const { members, mean, axis, error } = boxes[at];
        if (error === 0) break;
        const low = members.filter((b) => b.sum[axis] / b.n <= mean[axis]);
        const high = members.filter((b) => b.sum[axis] / b.n > mean[axis]);
        if (low.length === 0 || high.length === 0) { boxes[at].error = 0; continue; }
        boxes.splice(at, 1, measured(low), measured(high));
    }
    const palette = boxes.map((box) => box.mean.map(Math.round));
    const nearest = new Map();
    const indices = Buffer.alloc(width * height);
    for (let i = 0; i < indices.length; ++i) {
        const k = key(4 * i);
        if (!nearest.has(k)) {
            const distance = (p) => p.reduce((sum, v, c) => sum + (v - rgba[4 * i + c]) ** 2, 0);
            nearest.set(k, palette.reduce((best, p, j) => (distance(p) < distance(palette[best]) ? j : best), 0));
        }
        indices[i] = nearest.get(k);
    }
    return { palette, indices };
}

function crc(bytes) {
    let value = ~0;
    for (const byte of bytes) {
        value ^= byte;
        for (let bit = 0; bit < 8; ++bit) value = value & 1 ? value >>> 1 ^ 0xEDB88320 : value >>> 1;
    }
    return ~value >>> 0;
}

/** A PNG with a palette. */
function write(name, picture) {
    const { width, height } = picture;
    const { palette, indices } = quantize(picture);
    const rows = Buffer.alloc(height * (width + 1));
    for (let y = 0; y < height; ++y) indices.copy(rows, y * (width + 1) + 1, y * width, (y + 1) * width);
    const chunk = (type, data) => {
        const body = Buffer.concat([Buffer.from(type), data]);
        const ends = [Buffer.alloc(4), Buffer.alloc(4)];
        ends[0].writeUInt32BE(data.length);
        ends[1].writeUInt32BE(crc(body));
        return Buffer.concat([ends[0], body, ends[1]]);
    };
    const header = Buffer.alloc(13);
    header.writeUInt32BE(width, 0);
    header.writeUInt32BE(height, 4);
    header.set([8, 3, 0, 0, 0], 8);
    const chunks = [chunk('IHDR', header), chunk('PLTE', Buffer.from(palette.flat())), chunk('IDAT', deflateSync(rows, { level: 9 })), chunk('IEND', Buffer.alloc(0))];
    writeFileSync(join(folder, name), Buffer.concat([Buffer.from('\x89PNG\r\n\x1a\n', 'latin1'), ...chunks]));
}

// A photograph and its render, side by side.
const tests = join(demo, 'model/test');
const newest = readdirSync(tests).sort((a, b) => Number(a.split('_')[1]) - Number(b.split('_')[1])).at(-1);
const views = ['gt', 'renders'].map((kind) => readFileSync(join(tests, newest, kind, `0000${VIEW}.png`)));
write('held_out.png', await draw(views, `([photo, render], size) => {
    const gap = 8;
    const context = size(2 * photo.width + gap, photo.height);
    context.fillStyle = 'white';
    context.fillRect(0, 0, 2 * photo.width + gap, photo.height);
    context.drawImage(photo, 0, 0);
    context.drawImage(render, photo.width + gap, 0);
}`));

// The same view at several sizes: the photograph reduced, the usual filter, Mip-Splatting's. Small pictures are shown whole
// with larger pixels, of large ones the middle.
const camera = JSON.parse(readFileSync(join(demo, 'model/cameras.json')))[VIEW];
const cameraFile = join(profile, 'camera.json');
writeFileSync(cameraFile, JSON.stringify([camera]));
const rendered = (model, share) => {
    const out = join(profile, `${model}-${share}`);
    const size = ['width', 'height'].flatMap((side) => [`--${side}`, String(Math.round(share * camera[side]))]);
    execFileSync(program, ['render', join(demo, model), '--path', cameraFile, ...size, '-o', out, '--format', 'png', '--quiet']);
    return readFileSync(join(out, readdirSync(out).find((name) => name.endsWith('.png'))));
};
const sizes = ['model', 'mip'].flatMap((model) => SIZES.shares.map((share) => rendered(model, share)));
write('sizes.png', await draw([views[0], ...sizes], `([photo, ...renders], size) => {
    const { shares, width, height, gap } = ${JSON.stringify(SIZES)};
    const at = (i, side) => i * (side + gap);
    const context = size(at(shares.length, width) - gap, at(3, height) - gap);
    context.fillStyle = 'white';
    context.fillRect(0, 0, context.canvas.width, context.canvas.height);
    const cell = (row, column, picture) => {
        const zoom = Math.max(1, width / picture.width);
        context.imageSmoothingEnabled = false;
        const [shownWidth, shownHeight] = [width / zoom, height / zoom];
        const [left, top] = [(picture.width - shownWidth) / 2, (picture.height - shownHeight) / 2];
        context.drawImage(picture, left, top, shownWidth, shownHeight, at(column, width), at(row, height), width, height);
    };
    shares.forEach((share, column) => {
        const reduced = new OffscreenCanvas(share * photo.width, share * photo.height);
        const small = reduced.getContext('2d');
        small.imageSmoothingQuality = 'high';
        small.drawImage(photo, 0, 0, reduced.width, reduced.height);
        cell(0, column, reduced);
        [1, 2].forEach((row) => cell(row, column, renders[(row - 1) * shares.length + column]));
    });
}`));

// A row of the contact sheet: a margin of 8, a caption of 14 (see tools/ashsplat/demo/sheet.rs) and the picture.
const sheet = readFileSync(join(demo, 'contact_sheet.png'));
write('contact_sheet.png', await draw([sheet], `([sheet], size) => {
    const height = Math.round((sheet.height - 8) / 5 * ${SHEET.rows});
    const context = size(${SHEET.scale} * sheet.width, ${SHEET.scale} * height);
    context.drawImage(sheet, 0, 0, sheet.width, height, 0, 0, ${SHEET.scale} * sheet.width, ${SHEET.scale} * height);
}`));

// The viewer's page, once its sharp frame is there.
const server = start(program, ['view', join(demo, 'model'), '--port', '0', '--out', join(profile, 'view')], ['ignore', 'pipe', 'inherit']);
const address = await new Promise((done) => {
    createInterface({ input: server.stdout }).on('line', (line) => {
        const found = /^viewer at (http:\S+)/.exec(line);
        if (found) done(found[1]);
    });
});
await call('Emulation.setDeviceMetricsOverride', { width: PAGE.width, height: PAGE.height, deviceScaleFactor: 1, mobile: false });
await call('Page.navigate', { url: address });
const sharp = `(() => {
    const { shown, frames } = window.ashsplat ?? {};
    return Boolean(shown?.sharp && frames.sharp && !frames.dirty && shown.seq === frames.seq);
})()`;
await until(sharp);
// Moves to a photograph's place, so that the scene fills the page.
await evaluate(`document.querySelector('#photo-list button:nth-child(${8 * VIEW + 1})').click()`);
await until(`document.getElementById('photo').naturalWidth > 0`);
await evaluate(`document.getElementById('photo-close').click()`);
await pause(500);
await until(sharp);
await until(`[...document.querySelectorAll('#photo-list img')].filter((image) => image.naturalWidth > 0).length >= 12`);
await evaluate(`document.getElementById('panel').scrollTop = 0`);
const { data } = await call('Page.captureScreenshot', { format: 'png' });
await call('Emulation.clearDeviceMetricsOverride');
write('viewer.png', await draw([Buffer.from(data, 'base64')], `([page], size) => {
    const [width, height] = [page.width * ${PAGE.scale}, page.height * ${PAGE.scale}];
    size(width, height).drawImage(page, 0, 0, width, height);
}`));
const [browser] = children;
const closed = new Promise((done) => browser.on('exit', done));
await call('Browser.close');
await closed;
end();
process.exit(0);
