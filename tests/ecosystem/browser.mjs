// Opens a page in headless Chromium and waits for the picture that it posts.
import { spawn } from 'node:child_process';
import { mkdtempSync, rmSync, writeFileSync } from 'node:fs';
import { createServer } from 'node:http';
import { tmpdir } from 'node:os';
import { join } from 'node:path';

const TIMEOUT_SECONDS = 480;

// Start of every page: say(path, body) posts to the server, and errors are reported to it.
export const BEGIN = `const say = (path, body) => fetch(path, { method: 'POST', body });
window.onerror = (message) => say('/failed', String(message));
window.onunhandledrejection = (event) => say('/failed', String(event.reason && event.reason.stack || event.reason));`;

// content(url) returns [type, body]; for a missing file it throws or returns nothing. The page posts to /frame from time to
// time, to /text with lines to print, and to /done with a PNG's data URL, which ends the program; so does /failed.
export const show = (content, output) => {
    const profile = mkdtempSync(join(tmpdir(), 'ashsplat-chromium-'));
    let browser;
    const finish = (code, message) => {
        if (message) console.error(message);
        browser?.kill('SIGKILL');
        setTimeout(() => {
            try {
                rmSync(profile, { recursive: true, force: true, maxRetries: 5, retryDelay: 200 });
            } catch (error) {
                // Its temporary folder stays, because a process of the browser may still write.
            }
            process.exit(code);
        }, 500);
    };
    const heard = (url, body) => {
        if (url === '/frame') return;
        if (url === '/text') return console.log(body);
        if (url !== '/done') return finish(1, body);
        writeFileSync(output, Buffer.from(body.slice(body.indexOf(',') + 1), 'base64'));
        finish(0);
    };
    const server = createServer((request, response) => {
        const url = decodeURIComponent(request.url.split('?')[0]);
        if (request.method === 'POST') {
            let body = '';
            request.on('data', (part) => { body += part; });
            request.on('end', () => {
                response.end();
                heard(url, body);
            });
            return;
        }
        let found;
        try {
            found = content(url);
        } catch (error) {
            found = undefined;
        }
        const [type, body] = found ?? ['text/plain', ''];
        response.writeHead(found ? 200 : 404, { 'Content-Type': type });
        response.end(body);
    });
    server.listen(0, '127.0.0.1', () => {
        const flags = ['--headless=new', '--no-sandbox', '--disable-gpu-sandbox', '--use-angle=swiftshader',
            '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist', '--mute-audio', `--user-data-dir=${profile}`];
        browser = spawn('chromium', [...flags, `http://127.0.0.1:${server.address().port}/`], { stdio: 'ignore' });
        browser.on('error', (error) => finish(1, `chromium: ${error.message}`));
    });
    setTimeout(() => finish(1, `no picture after ${TIMEOUT_SECONDS} s`), TIMEOUT_SECONDS * 1000).unref();
};
