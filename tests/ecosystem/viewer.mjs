// Uses the viewer in headless Chromium as a person would: a model, then a training.
//
// node viewer.mjs MODULES PROGRAM FOLDER
//   MODULES: a node_modules folder with playwright-core; PROGRAM: ashsplat; FOLDER: one that `ashsplat demo` filled, for
//   the screenshots too
import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { createRequire } from 'node:module';
import { readFileSync } from 'node:fs';
import { createServer, request } from 'node:http';
import { join, resolve } from 'node:path';
import { createInterface } from 'node:readline';

const [modules, program, folder] = process.argv.slice(2).map((path) => resolve(path));
const { chromium } = createRequire(join(resolve(modules), 'x.js'))('playwright-core');
const PATIENCE = 120_000;
const children = new Set();

/** Starts the program; resolves with its page's address. */
function serve(...args) {
    const child = spawn(program, args, { cwd: folder, stdio: ['ignore', 'pipe', 'inherit'] });
    children.add(child);
    child.on('exit', () => children.delete(child));
    return new Promise((done, fail) => {
        child.on('error', fail);
        child.on('exit', (code) => fail(new Error(`${args.join(' ')} ended with ${code}`)));
        createInterface({ input: child.stdout }).on('line', (line) => {
            const address = /^viewer at (http:\S+)/.exec(line)?.[1];
            if (address) done({ child, address, port: new URL(address).port });
        });
    });
}

function end(child) {
    const gone = new Promise((done) => child.on('exit', done));
    child.kill('SIGKILL');
    return gone;
}

const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium', args: ['--no-sandbox'] });
const errors = [];
async function open(address, more = {}) {
    const page = await browser.newPage({ viewport: { width: 1280, height: 720 }, ...more });
    page.setDefaultTimeout(PATIENCE);
    page.on('pageerror', (error) => errors.push(error.stack));
    // The console reports broken connections, the request for their reason, and refused paths as errors: expected here.
    page.on('console', (message) => {
        const meant = /WebSocket|net::ERR_/.test(message.text()) || /\/(open|socket)$/.test(message.location().url);
        if (message.type() === 'error' && !meant) errors.push(message.text());
    });
    await page.goto(address);
    return page;
}

const sharp = (page) => page.waitForFunction(() => window.ashsplat?.shown?.sharp && ashsplat.frames.sharp && !ashsplat.frames.dirty && ashsplat.shown.seq === ashsplat.frames.seq);
const state = (page) => page.evaluate(() => ({ position: ashsplat.camera.position, pivot: ashsplat.camera.pivot, seq: ashsplat.shown.seq }));
const distance = (s) => Math.hypot(...s.position.map((v, i) => v - s.pivot[i]));
const shot = (page, name) => page.screenshot({ path: join(folder, `viewer_${name}.png`) });
/** Mean and deviation of the picture's brightness, and its pixels' sum weighted by place: another picture has another. */
const picture = (page) => page.evaluate(() => {
    const canvas = document.getElementById('picture');
    const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    let sum = 0, squares = 0, places = 0;
    for (let i = 0; i < data.length; i += 4) { sum += data[i]; squares += data[i] ** 2; places += data[i] * ((i / 4) % 997); }
    const n = data.length / 4;
    return { mean: sum / n, deviation: Math.sqrt(squares / n - (sum / n) ** 2), places };
});

async function looksThrough(page) {
    await sharp(page);
    const first = await picture(page);
    assert(first.deviation > 8, 'an empty picture');
    await shot(page, 'model');

    // Orbit: the view moves, frames become coarse, and sharp again at rest.
    const before = await state(page);
    const widths = await page.evaluateHandle(() => { const seen = new Set(); ashsplat.link.on('frame', (h) => seen.add(h.width)); return seen; });
    await page.mouse.move(560, 360);
    await page.mouse.down();
    for (let i = 1; i <= 12; ++i) {
        await page.mouse.move(560 + 14 * i, 360 + 4 * i);
        await page.waitForTimeout(40);
    }
    // Coarse frames are requested while the button is held, however long the first takes.
    await page.waitForFunction((seen) => Math.min(...seen) < 1280, widths);
    await page.mouse.up();
    await sharp(page);
    const after = await state(page);
    assert.notDeepEqual(after.position, before.position);
    assert(Math.abs(distance(after) - distance(before)) < 1e-3 * distance(before), 'an orbit keeps its distance');
    assert.notEqual((await picture(page)).places, first.places);

    // Pan, zoom, fly.
    for (const act of [
        async () => { await page.mouse.move(500, 300); await page.mouse.down({ button: 'right' }); await page.mouse.move(540, 320, { steps: 4 }); await page.mouse.up({ button: 'right' }); },
        () => page.mouse.wheel(0, -300),
        () => held(page, 'w'),
        () => held(page, 'ArrowLeft')
    ]) {
        const old = await state(page);
        await act();
        await moved(page, old);
    }
    await page.keyboard.press('Home');
    await sharp(page);
    assert.equal((await picture(page)).places, first.places, 'Home is the first view');

    // Each mode looks different.
    const seen = new Set([first.places]);
    for (const mode of ['centres', 'ellipsoids', 'depth', 'tiles']) {
        await page.click(`[data-mode=${mode}]`);
        await sharp(page);
        seen.add((await picture(page)).places);
        assert.equal(await page.isVisible('#legend'), ['depth', 'tiles'].includes(mode));
        await shot(page, mode);
    }
    assert.equal(seen.size, 5);
    await page.keyboard.press('1');

    // Jumps to a photo, wipes, and leaves it again.
    await page.click('#photo-list button:nth-child(5)');
    await page.waitForFunction(() => { const p = document.getElementById('photo'); return !p.hidden && p.naturalWidth > 0; });
    await sharp(page);
    const clip = () => page.evaluate(() => document.getElementById('photo').style.clipPath);
    const half = await clip();
    const box = await page.locator('#wipe').boundingBox();
    await page.mouse.move(box.x + box.width / 2, 360);
    await page.mouse.down();
    await page.mouse.move(box.x + 60, 360, { steps: 5 });
    await page.mouse.up();
    assert.notEqual(await clip(), half);
    await shot(page, 'photo');
    await page.keyboard.press(']');
    await page.waitForFunction(() => ashsplat.photos.current === 5);
    await page.keyboard.press('Escape');
    await page.waitForSelector('#photo', { state: 'hidden' });

    // A pixel, and the pivot below the pointer.
    await page.click('#inspect');
    await page.mouse.click(640, 380);
    await page.waitForSelector('#picked-table tbody tr');
    await shot(page, 'pixel');
    await page.click('#inspect');
    await turnsAround(page, () => page.mouse.dblclick(600, 400));

    // A film of two keys.
    await page.keyboard.press('k');
    await page.keyboard.press('ArrowRight', { delay: 200 });
    await page.keyboard.press('k');
    await page.fill('#film-seconds', '0.5');
    await page.click('#film-render');
    await page.waitForFunction(() => document.querySelector('#film-result img')?.naturalWidth > 0);
    await page.locator('#film-result').scrollIntoViewIfNeeded();
    await shot(page, 'film');

    // A screenshot is a PNG of the whole picture.
    const [saved] = await Promise.all([page.waitForEvent('download'), page.click('#shot')]);
    assert.match(saved.suggestedFilename(), /^ashsplat-.*\.png$/);
}

/** Sets sliders as a user does. */
const slide = (page, selector, value) => page.locator(selector).evaluate((input, value) => {
    input.value = value;
    input.dispatchEvent(new Event('input'));
}, value);

/** Saves what is shown or selected as `exported.FORMAT`. */
async function saves(page, part, format, name) {
    await page.selectOption('#export-part', part);
    await page.selectOption('#export-format', `.${format}`);
    const [saved] = await Promise.all([page.waitForEvent('download'), page.click('#export-save')]);
    assert.equal(saved.suggestedFilename(), name);
    await saved.saveAs(join(folder, `exported.${format}`));
}

const rows = () => Number(readFileSync(join(folder, 'exported.ply'), 'latin1').match(/element vertex (\d+)/)[1]);

/** Lasso, brush and sphere select; what is deleted comes back with undo. */
async function selects(page) {
    await page.keyboard.press('Home');
    await sharp(page);
    const whole = await picture(page), stem = await page.evaluate(() => document.title.split(' ')[0].replace(/\.\w+$/, ''));
    const selected = () => page.evaluate(() => ashsplat.shown.edits?.selected ?? 0);
    const counts = new Set();
    for (const [key, path] of [['g', [[460, 200], [640, 220], [620, 500], [470, 480]]], ['b', [[500, 300], [600, 400]]], ['n', [[540, 350], [590, 350]]]]) {
        await page.keyboard.press(key);
        const before = await selected();
        await page.mouse.move(...path[0]);
        await page.mouse.down();
        for (const point of path.slice(1)) await page.mouse.move(...point, { steps: 6 });
        await shot(page, `tool_${key}`);
        await page.mouse.up();
        await page.waitForFunction((before) => ![0, before].includes(ashsplat.shown.edits?.selected ?? 0), before);
        await sharp(page);
        counts.add(await selected());
        await page.keyboard.press(key);
    }
    assert.equal(counts.size, 3);
    assert.notEqual((await picture(page)).places, whole.places, 'the selection has its colour');
    await shot(page, 'selected');
    const count = await selected();
    await saves(page, 'selection', 'ply', `${stem}_selection.ply`);
    assert.equal(rows(), count);
    await page.locator('#overlay').focus();
    await page.keyboard.press('Delete');
    await page.waitForFunction((count) => ashsplat.shown.edits.deleted === count, count);
    await sharp(page);
    await shot(page, 'deleted');
    for (let steps = 4; steps > 0; --steps) {
        await page.keyboard.press('Control+z');
        await page.waitForFunction((steps) => ashsplat.shown.edits.undo === steps, steps - 1);
    }
    await sharp(page);
    assert.equal((await picture(page)).places, whole.places, 'all is undone');
}

/** A known length on the tape scales the scene, three clicks level it, and a link keeps the view. */
async function places(page, address) {
    const command = (option) => page.waitForFunction((option) => document.getElementById('command-text').textContent.includes(option), option);
    await page.keyboard.press('m');
    for (const point of [[530, 250], [550, 400]]) {
        await page.mouse.click(...point);
        await page.waitForTimeout(800);
    }
    await page.waitForFunction(() => ashsplat.tape.measured > 0);
    await page.keyboard.press('m');
    await page.fill('#tape-known input', '10');
    await page.press('#tape-known input', 'Enter');
    await command('--scale=');
    assert(Math.abs(await page.evaluate(() => ashsplat.tape.measured) - 10) < 1e-3);
    await shot(page, 'tape');
    await page.click('#level');
    for (const point of [[530, 300], [545, 390], [520, 450]]) {
        await page.mouse.click(...point);
        await page.waitForTimeout(600);
    }
    await command('--rotate=');
    await sharp(page);
    await page.locator('#place').scrollIntoViewIfNeeded();
    await shot(page, 'level');
    await page.click('#place-reset');
    await page.waitForFunction(() => ashsplat.place.isIdentity);
    await page.click('#link');
    await page.waitForFunction(() => location.hash.startsWith('#view='));
    const other = await open(address + await page.evaluate(() => location.hash));
    await sharp(other);
    const [here, there] = [await state(page), await state(other)];
    assert(Math.hypot(...here.position.map((value, axis) => value - there.position[axis])) < 1e-4 * distance(here), 'a link has the view');
    assert.equal(await other.evaluate(() => location.hash), '', 'the link is for one scene');
    await other.close();
}

/** The page works below a path of a proxy, which strips the path. */
async function worksBelowAPath(address) {
    const [upstream, prefix] = [new URL(address), '/a/deep/path'];
    const options = ({ url, method, headers }) => ({ port: upstream.port, path: url.slice(prefix.length), method, headers });
    const proxy = createServer((asked, answer) => {
        asked.pipe(request(options(asked), (got) => { answer.writeHead(got.statusCode, got.headers); got.pipe(answer); }));
    });
    proxy.on('upgrade', (asked, socket) => {
        request(options(asked)).on('upgrade', (got, there, first) => {
            const head = Object.entries(got.headers).map(([name, value]) => `${name}: ${value}\r\n`).join('');
            socket.write(`HTTP/1.1 101 Switching Protocols\r\n${head}\r\n`);
            socket.write(first);
            there.pipe(socket).pipe(there);
        }).end();
    });
    await new Promise((done) => proxy.listen(0, '127.0.0.1', done));
    const page = await open(`http://127.0.0.1:${proxy.address().port}${prefix}/`);
    await sharp(page);
    await page.close();
    proxy.close();
}

/** A cut shows in the picture at once; command and exported file make the same cut. */
async function cuts(page) {
    await page.keyboard.press('Home');
    await sharp(page);
    const whole = await picture(page);
    assert.equal(await page.isVisible('#command'), false);
    const seen = new Set([whole.places]);
    for (const [selector, value, option] of [
        // Fog is faint: of what is opaque, little is fog.
        ['#floaters', '80', '--min-density '], ['#min-opacity', '0.5', '--min-opacity 0.5'], ['[data-axis="2"] input >> nth=0', '200', '--crop-box=-inf,-inf,']
    ]) {
        await slide(page, selector, value);
        await page.waitForFunction((option) => document.getElementById('command-text').textContent.includes(option), option);
        await sharp(page);
        seen.add((await picture(page)).places);
    }
    assert.equal(seen.size, 4);
    await page.waitForSelector('#cut-count');
    const stay = Number((await page.textContent('#cut-count')).split(' ')[0].replaceAll(',', ''));
    await page.locator('#command').scrollIntoViewIfNeeded();
    await shot(page, 'filter');
    for (const format of ['ply', 'spz']) {
        await saves(page, '', format, `model_cut.${format}`);
    }
    assert.equal(stay, rows(), 'the page counts what the file holds');
    // The cut is switched off, on, and reset.
    await page.keyboard.press('x');
    await page.waitForSelector('#command', { state: 'hidden' });
    await sharp(page);
    assert.equal((await picture(page)).places, whole.places);
    await page.keyboard.press('x');
    await page.waitForSelector('#command');
    await page.click('#filter-reset');
    await page.waitForSelector('#command', { state: 'hidden' });
    const labels = await page.locator('#photo-list span').allTextContents();
    assert(labels.length > 8 && new Set(labels).size === labels.length, 'labels differ');
}

/** Lists parts of the page that overlap or stick out. */
const overlaps = (page) => page.evaluate(() => {
    const seen = [];
    for (const id of ['title', 'tools', 'legend', 'panel', 'panel-toggle', 'status', 'message', 'stage-state', 'opener']) {
        const part = document.getElementById(id), box = part.getBoundingClientRect();
        if (part.checkVisibility({ visibilityProperty: true }) && box.width > 0 && box.left < innerWidth) seen.push({ id, box });
    }
    const over = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1 && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1;
    const pairs = seen.flatMap((a, i) => seen.slice(i + 1).filter((b) => over(a.box, b.box)).map((b) => `${a.id} and ${b.id}`));
    const out = seen.filter(({ box }) => box.left < 0 || box.top < 0 || box.right > innerWidth + 1 || box.bottom > innerHeight + 1);
    return [...pairs, ...out.map(({ id }) => `${id} sticks out`)];
});

/** On screens of all sizes; on a phone the panel is closed at first. */
async function fits(address) {
    for (const [width, height] of [[1440, 900], [1024, 768], [390, 844], [844, 390]]) {
        const phone = Math.min(width, height) < 500;
        const page = await open(address, { viewport: { width, height }, hasTouch: phone, isMobile: phone });
        await sharp(page);
        assert.equal(await page.evaluate(() => document.body.classList.contains('bare')), phone);
        for (const wanted of [phone, !phone]) {
            if (await page.evaluate(() => document.body.classList.contains('bare')) !== wanted) await page.click('#panel-toggle');
            await page.click('[data-mode=depth]');
            await sharp(page);
            await page.waitForTimeout(400);
            assert.deepEqual(await overlaps(page), [], `${width}x${height}`);
            await shot(page, `${width}${wanted ? '' : '_panel'}`);
        }
        await page.click('#help');
        await shot(page, `${width}_keys`);
        await listCloses(page);
        assert.equal(await page.isVisible('#scene-brief'), width === 390);
        await page.close();
    }
}

/** The list of keys takes the keys: Esc and `?` close it, and the scene behind it does not move. */
async function listCloses(page) {
    const seen = () => page.evaluate(() => JSON.stringify([document.body.className, document.getElementById('keys').open, ashsplat.camera.position, ashsplat.overlay.showsCameras]));
    const before = await seen();
    for (const key of ['h', 'w', 'c', 'ArrowLeft']) await page.keyboard.press(key);
    assert.equal(await seen(), before, 'keys act behind the list');
    for (const key of ['Escape', '?']) {
        await page.keyboard.press(key);
        await page.waitForFunction(() => !document.getElementById('keys').open);
        await page.keyboard.press('?');
        await page.waitForFunction(() => document.getElementById('keys').open);
    }
}

/** A viewer without a scene takes a path and files. */
async function opensFiles() {
    const served = await serve('view', '-o', join(folder, 'films'), '--port', '0');
    for (const width of [390, 1024]) {
        const page = await open(served.address, { viewport: { width, height: 768 } });
        await page.waitForSelector('#drop');
        assert.deepEqual(await overlaps(page), []);
        await shot(page, `empty_${width}`);
        await page.close();
    }
    const page = await open(served.address);
    await page.fill('#path', '../model');
    await page.press('#path', 'Enter');
    await page.waitForSelector('#stage-state.failed');
    assert.match(await page.textContent('#stage-text'), /is not in /);
    await page.click('#stage-state');
    await page.fill('#path', 'mo');
    await page.waitForFunction(() => [...document.getElementById('paths').options].some(({ value }) => value === 'model/'));
    await page.fill('#path', 'model');
    await page.press('#path', 'Enter');
    await page.waitForSelector('#welcome', { state: 'hidden' });
    await sharp(page);
    // Drops a file as a user does.
    const file = readFileSync(join(folder, 'exported.spz')).toString('base64');
    await page.evaluate((file) => {
        const bytes = Uint8Array.from(atob(file), (c) => c.charCodeAt(0));
        const data = new DataTransfer();
        data.items.add(new File([bytes], 'dropped here.spz'));
        for (const type of ['dragenter', 'dragover', 'drop']) document.body.dispatchEvent(new DragEvent(type, { dataTransfer: data, bubbles: true, cancelable: true }));
    }, file);
    await page.waitForFunction(() => document.getElementById('scene-name').textContent.includes('dropped here.spz'));
    await sharp(page);
    assert((await picture(page)).deviation > 8, 'an empty picture');
    await shot(page, 'dropped');
    // Two files are scenes side by side.
    const two = ['one', 'two'].map((name) => ({ name: `${name}.spz`, mimeType: 'application/octet-stream', buffer: readFileSync(join(folder, 'exported.spz')) }));
    await page.setInputFiles('#choose-file', two);
    await page.waitForFunction(() => document.querySelectorAll('#edit-scenes button').length === 2);
    await sharp(page);
    // Another joins them, and the placement stays.
    await page.evaluate((file) => {
        ashsplat.place.set({ scale: [2] });
        ashsplat.stage.send(new File([Uint8Array.from(atob(file), (c) => c.charCodeAt(0))], 'three.spz'), true);
    }, file);
    await page.waitForFunction(() => document.querySelectorAll('#edit-scenes button').length === 3);
    await sharp(page);
    assert.equal(await page.evaluate(() => document.getElementById('command-text').textContent), 'ashsplat convert one.spz two.spz three.spz one_cut.ply --scale=2');
    await page.setInputFiles('#choose-file', { name: 'bad.ply', mimeType: 'application/octet-stream', buffer: Buffer.from('nonsense') });
    await page.waitForSelector('#stage-state.failed');
    assert.match(await page.textContent('#stage-text'), /^bad\.ply: /);
    await end(served.child);
}

/** Two quick clicks or taps set the pivot; on a busy machine they may come too slowly for it, and are made again. */
async function turnsAround(page, twice) {
    const { pivot } = await state(page);
    for (let tries = 0; ; ++tries) {
        await twice();
        const changed = page.waitForFunction((p) => String(ashsplat.camera.pivot) !== p, String(pivot), { timeout: tries < 20 ? 3000 : PATIENCE });
        if (await changed.then(() => true, (error) => { if (tries >= 20) throw error; })) return;
    }
}

/** One finger orbits, two pan and pinch, two taps set the pivot. */
async function feelsTouch(address) {
    const page = await open(address, { hasTouch: true });
    await sharp(page);
    const cdp = await page.context().newCDPSession(page);
    const touch = (type, ...points) => cdp.send('Input.dispatchTouchEvent', { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
    /** Moves fingers from places to places, waits until the view is as expected, then lifts them. */
    async function fingers(from, to, expected) {
        const before = await state(page);
        await touch('touchStart', ...from);
        for (let i = 1; i <= 8; ++i) await touch('touchMove', ...from.map(([x, y], f) => [x + (to[f][0] - x) * i / 8, y + (to[f][1] - y) * i / 8]));
        await page.waitForFunction(expected, before);
        await touch('touchEnd');
        await sharp(page);
        return [before, await state(page)];
    }
    const [before, after] = await fingers([[500, 300]], [[600, 340]], (old) => String(ashsplat.camera.position) !== String(old.position));
    assert.deepEqual(after.pivot, before.pivot, 'one finger orbits');
    assert(Math.abs(distance(after) - distance(before)) < 1e-3 * distance(before));
    const far = distance(after);
    // Fingers at twice their distance halve the distance to the pivot, which stays.
    const [, near] = await fingers([[500, 350], [600, 350]], [[450, 350], [650, 350]], (old) => {
        const to = (p) => Math.hypot(...old.pivot.map((v, i) => p[i] - v)), { camera } = ashsplat;
        return Math.abs(to(camera.position) / to(old.position) - 0.5) < 0.02;
    });
    assert(Math.abs(distance(near) / far - 0.5) < 0.02, 'two fingers pinch');
    const [still, panned] = await fingers([[500, 350], [600, 350]], [[560, 380], [660, 380]], (old) => String(ashsplat.camera.pivot) !== String(old.pivot));
    assert(Math.abs(distance(panned) - distance(still)) < 0.1 * distance(still), 'two fingers pan');
    const shift = (key) => Math.hypot(...panned[key].map((v, i) => v - still[key][i]));
    assert(shift('pivot') > 0 && Math.abs(shift('pivot') - shift('position')) < 0.1 * distance(still));
    const tap = async () => { await touch('touchStart', [600, 400]); await touch('touchEnd'); };
    await turnsAround(page, async () => { await tap(); await tap(); });
    await sharp(page);
    await shot(page, 'touched');
    await page.close();
}

const moved = (page, old) => page.waitForFunction((p) => String(ashsplat.camera.position) !== p, String(old.position));

/** Holds a key until the view has moved: frames may be few where the machine is busy. */
async function held(page, key) {
    const old = await state(page);
    await page.keyboard.down(key);
    await moved(page, old);
    await page.keyboard.up(key);
}

/** The page recovers after the program restarts, and after its own reload. */
async function comesBack(page, served, args) {
    await end(served.child);
    await page.waitForSelector('#connection.bad');
    await shot(page, 'broken');
    // A new picture may arrive before the test asks, so its number shows that it is another one.
    const last = await page.evaluate(() => ashsplat.frames.seq);
    const again = await serve(...args, '--port', served.port);
    await page.waitForSelector('#connection:not(.bad)');
    await page.waitForFunction((last) => ashsplat.shown.seq > last, last);
    await sharp(page);
    await end(again.child);
}

async function steersTraining() {
    const served = await serve('train', '-s', join(folder, 'dataset'), '-m', join(folder, 'watched'), '--iterations', '1000000', '--eval', '--view=0', '--quiet');
    const page = await open(served.address);
    await sharp(page);
    const iteration = () => page.evaluate(() => Number(document.getElementById('training-text').textContent.split('/')[0].replace(/\D/g, '')));
    await page.waitForFunction(() => ashsplat.training.curves.loss.length > 30 && ashsplat.training.curves.rate.length > 1 && ashsplat.training.curves.psnr.length > 0);
    await shot(page, 'training');
    await page.click('#train-pause');
    // The paused status also has the iteration.
    await page.waitForFunction(() => ashsplat.training.paused);
    const at = await iteration();
    await page.waitForTimeout(1500);
    assert.equal(await iteration(), at, 'it waits');
    await page.click('#train-step');
    await page.waitForFunction((old) => Number(document.getElementById('training-text').textContent.split('/')[0].replace(/\D/g, '')) === old + 1, at);
    await page.locator('#overlay').focus();
    await page.keyboard.press('Space');
    await page.waitForFunction(() => !ashsplat.training.paused);
    const gone = new Promise((done) => served.child.on('exit', done));
    await page.click('#train-stop');
    assert.equal(await gone, 130);
}

let failed = null;
try {
    const args = ['view', join(folder, 'model'), '-o', join(folder, 'films')];
    const served = await serve(...args, '--port', '0');
    const page = await open(served.address);
    await looksThrough(page);
    await cuts(page);
    await selects(page);
    await places(page, served.address);
    await worksBelowAPath(served.address);
    await feelsTouch(served.address);
    await fits(served.address);
    await comesBack(page, served, args);
    await page.close();
    await opensFiles();
    await steersTraining();
    assert.deepEqual(errors, []);
} catch (error) {
    failed = error;
    console.error(error.stack, errors.join('\n'));
}
for (const child of children) child.kill('SIGKILL');
await browser.close();
process.exit(failed ? 1 : 0);
