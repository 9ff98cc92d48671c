// All texts of the page: a translation changes this file alone, and keeps the names before the colons.
//
// An entry is a text, an element's text, attributes or rows, or a function of what its text mentions.

export const language = 'en';

export const number = (value, digits = 0) => value.toLocaleString(language, { minimumFractionDigits: digits, maximumFractionDigits: digits });
const size = (bytes) => (bytes < 1e9 ? `${number(bytes / 1e6, 1)} MB` : `${number(bytes / 1e9, 1)} GB`);

const rules = new Intl.PluralRules(language);
/** A number and its noun. The language decides whether the noun's form is `zero`, `one`, `two`, `few`, `many` or `other`. */
const count = (value, forms) => `${number(value)} ${forms[rules.select(value)] ?? forms.other}`;
const GAUSSIANS = { one: 'Gaussian', other: 'Gaussians' };
const TILES = { one: 'tile', other: 'tiles' };
const INSTANCES = { one: 'instance', other: 'instances' };
const KEYS = { one: 'key', other: 'keys' };
const FRAMES = { one: 'frame', other: 'frames' };
const FILMS = { one: 'film', other: 'films' };

export const texts = {
    // What the page waits for, and what went wrong.
    connecting: 'connecting', connected: 'connected', connectionLost: 'connection lost, trying again',
    noConnection: (reason) => (reason ? `no connection, trying again: ${reason}` : 'no connection, trying again'),
    noAnswer: 'no answer: has the viewer ended, is its port still forwarded?', viewerEnded: 'no answer: has the viewer ended?',
    elsewhere: (status, path) => `${status} at ${path}, which a proxy must lead to the viewer`,
    starting: 'starting', waitingForScene: 'waiting for the scene', waitingForPicture: 'waiting for the first picture',
    reading: (name) => `reading ${name}`, opening: (path) => `opening ${path}`, sending: (file) => `sending ${file}`,
    waitedFor: (what, seconds) => `${what}, ${seconds} s`,
    opensNothing: 'this viewer shows what it was started with; start `ashsplat view` without a path to open others',
    wrongFormat: (file, formats) => `${file} is none of ${formats}`,
    tooLarge: (file, bytes, most) => `${file} has ${size(bytes)}; reading may take ${size(most)} here (--max-host-memory)`,
    notSent: (file) => `${file} could not be sent`, notAsked: (path) => `${path} could not be asked for`,
    refused: (status) => `refused (${status})`,
    // The page without a scene.
    dropHere: 'Drop files here', chooseFiles: 'Choose files', open: 'Open',
    pathBelow: (folder) => ['or a path on the machine that draws, below ', folder],
    path: { placeholder: 'scene.ply, a model folder or a data set' },
    dropping: 'Drop to open; with Shift beside the open scene',
    scenesInFolder: (all) => (all ? 'Scenes in this folder' : 'Scenes in this folder, not all'),
    // The picture, and the line below it.
    picture: { 'aria-label': 'The scene. Drag to orbit, right-drag to pan, scroll to zoom.' },
    wipe: { title: 'Drag: photo on the left, render on the right' },
    render: 'render', photo: 'photo', photoHeldOut: 'photo, held out', photoUnreadable: 'photo: cannot be read',
    gaussians: (all) => count(all, GAUSSIANS),
    visible: (visible, all, instances) => `${number(visible)} of ${count(all, GAUSSIANS)} visible, ${count(instances, INSTANCES)}`,
    // Narrow screens leave out the second part.
    speed: (rate, latency, rendering) => (latency === null ? [`${number(rate, 1)} frames/s`] : [`${number(rate, 1)} frames/s · ${Math.round(latency)} ms`, `, of which rendering ${Math.round(rendering)}`]),
    depthUnit: 'depth, scene units', tilesUnit: 'Gaussians per tile',
    // Tools.
    modes: { 'aria-label': 'What is drawn' },
    splats: { text: 'Splats', title: 'Splats: the picture itself (1)' },
    centres: { text: 'Centres', title: 'Centres: a dot at each mean (2)' },
    ellipsoids: { text: 'Ellipsoids', title: 'Ellipsoids: surfaces at two standard deviations; opacities below 0.2 are left out (3)' },
    depth: { text: 'Depth', title: 'Expected depth: near is red (4)' },
    tiles: { text: 'Tiles', title: 'Gaussians per tile of 16 pixels, logarithmic (5)' },
    normals: { text: 'Normals', title: 'Normals as colours: x, y, z of the scene are red, green, blue (6)' },
    fly: { text: 'Fly', title: 'Fly: drag looks around, W A S D Q E move (V)' },
    inspect: { text: 'Inspect', title: 'Click a pixel to list the Gaussians blended there (I)' },
    cameras: { text: 'Cameras', title: 'Show where the photos were taken (C)' },
    lasso: { text: 'Lasso', title: 'Lasso: draw around Gaussians to select them; Shift adds, Alt removes (G)' },
    brush: { text: 'Brush', title: 'Brush: paint over Gaussians to select them; Shift adds, Alt removes (B)' },
    sphere: { text: 'Sphere', title: 'Sphere: drag from a surface to select the Gaussians around; Shift adds, Alt removes (N)' },
    noSurface: 'nothing is there: begin on a surface, and drag outwards',
    tape: { text: 'Measure', title: 'Measure: click two points of the scene (M)' },
    home: { text: 'Home', title: 'Back to the first view (Home)' },
    screenshot: { text: 'Screenshot', title: 'Save a screenshot, lossless (P)' },
    link: { text: 'Link', title: "Copy the page's address with this view in it" },
    linkCopied: (token) => `copied: the page's address with this view${token ? ', with the token in it' : ''}`,
    linkShown: (token) => `the page's address has this view now${token ? ', with the token in it' : ''}: copy it`,
    fullScreen: { text: 'Full screen', title: 'Whole screen (Shift F)' },
    noFullScreen: (reason) => `no whole screen: ${reason}`,
    help: { text: 'Keys', title: 'Keys, mouse and touch (?)' },
    panel: { title: 'Show or hide the panel (H)', 'aria-label': 'Show or hide the panel' },
    // Panel: training.
    training: 'Training',
    progress: (iteration, iterations, paused) => `${number(iteration)} / ${number(iterations)}${paused ? ', paused' : ''}`,
    pause: { text: 'Pause', title: 'Pause and go on (Space)' }, resume: 'Resume', trainingStep: { text: 'Step', title: 'One iteration' },
    trainingSave: { text: 'Save', title: 'Save a PLY now' },
    trainingStop: { text: 'Stop', title: 'Save, write a checkpoint, end the training' },
    loss: 'Loss', psnr: 'PSNR, dB', trainedGaussians: 'Gaussians', rate: 'Iterations per second',
    // Panel: appearance.
    appearance: 'Appearance', fieldOfView: 'Field of view', splatScale: 'Scale', shDegree: 'SH degree',
    background: 'Background', asTrained: 'as trained', sharpness: 'Sharpness', fullResolution: 'full resolution', stillFrames: 'Still frames', jpeg: 'JPEG', png: 'PNG, lossless',
    // Panel: trees of tiles.
    detail: 'Level of detail', budget: 'Budget',
    budgetHelp: { title: 'Gaussians of a picture, at most: the tiles whose error is largest in pixels are the finest' },
    detailDrawn: (drawn, all, tiles) => `${number(drawn)} of ${count(all, GAUSSIANS)} in ${count(tiles, TILES)}`,
    detailTiles: (wanted, missing, resident, gaussians) => `${count(wanted, TILES)} wanted${missing ? `, ${number(missing)} on their way` : ''}; ${number(resident)} in memory (${count(gaussians, GAUSSIANS)})`,
    coarserTile: (problem, others) => `A coarser tile is drawn: ${problem}${others ? ` (and ${number(others)} more)` : ''}`,
    // Panel: filter and export.
    filter: 'Filter', showAll: 'show all',
    minOpacity: 'Min. opacity', minOpacityHelp: { title: 'Hides Gaussians that are fainter' }, everyOpacity: 'all',
    floaters: 'Floaters', floatersShown: 'shown',
    floatersHelp: { title: "Hides what is faint for its size, as fog is: opacity / (1 − opacity) per largest standard deviation, as a share of the scene's median" },
    boxX: 'Box x', fromX: { 'aria-label': 'x, from' }, toX: { 'aria-label': 'x, to' },
    boxY: 'Box y', fromY: { 'aria-label': 'y, from' }, toY: { 'aria-label': 'y, to' },
    boxZ: 'Box z', fromZ: { 'aria-label': 'z, from' }, toZ: { 'aria-label': 'z, to' },
    stay: (kept, all) => `${number(kept)} of ${count(all, GAUSSIANS)} stay`,
    command: 'The same by a command:', copyCommand: { text: 'Copy', title: 'Copy the command' }, copied: 'copied',
    exportPart: { 'aria-label': 'What is saved' }, exportShown: 'shown', exportSelected: 'selected', exportFormat: { 'aria-label': 'Format' }, exportSave: 'Save',
    exported: (file, losses) => [`${file} is made; the browser saves it as it comes`, ...losses].join('; '),
    // Panel: selection.
    selection: 'Selection',
    edits: (selected, hidden, deleted) => [selected && `${number(selected)} selected`, hidden && `${number(hidden)} hidden`, deleted && `${number(deleted)} deleted`].filter(Boolean).join(', '),
    selectNew: 'new', selectAdd: 'add', selectAddHelp: { title: 'Shift' }, selectRemove: 'remove', selectRemoveHelp: { title: 'Alt' },
    brushSize: 'Brush', pixels: (radius) => `${radius} px`,
    selectAll: { text: 'All', title: 'All Gaussians that are seen (Ctrl A)' }, selectNone: 'None', selectInvert: 'Invert',
    hide: { text: 'Hide', title: 'Hide the selection' },
    show: { text: 'Show hidden', title: 'Show all that is hidden' },
    delete: { text: 'Delete', title: 'Delete the selection; no file changes (Del)' },
    undo: { text: 'Undo', title: 'Ctrl Z' }, redo: { text: 'Redo', title: 'Ctrl Shift Z, Ctrl Y' },
    selectScene: (name, gaussians) => `Select this scene: ${name}, ${count(gaussians, GAUSSIANS)}`,
    // Panel: placement and tape.
    placement: 'Placement', reset: 'reset',
    turn: { text: 'Turn, °', title: 'Degrees about x, then y, then z' },
    aboutX: { 'aria-label': 'about x' }, aboutY: { 'aria-label': 'about y' }, aboutZ: { 'aria-label': 'about z' },
    sceneScale: 'Scale', scaleBy: { 'aria-label': 'scale' },
    move: 'Move', alongX: { 'aria-label': 'along x' }, alongY: { 'aria-label': 'along y' }, alongZ: { 'aria-label': 'along z' },
    badPlacement: 'a turn and a move are numbers, and a scale is a positive number',
    level: { text: 'Level', title: 'Click three points of the floor: it becomes level, at height 0' }, grid: 'grid',
    noFloor: 'nothing is there: click the floor', noTriangle: 'the three points lie on a line: click others',
    measure: 'Measure', tapeClear: { title: 'Remove the tape' },
    knownLength: 'Known length', knownLengthHelp: { title: 'Scales the scene so that the tape is that long' },
    noTapeEnd: 'nothing is there to measure from', otherEnd: 'click the other end',
    tapeLength: (units) => `${units} units of the scene`,
    // Panel: photos, and the Gaussians of a pixel.
    photos: 'Photos', heldOut: 'held out',
    photoTitle: (name, heldOut, lit) => [name, heldOut && 'held out', lit && 'its exposure is known'].filter(Boolean).join(', '),
    photoPrevious: { text: 'Previous', title: 'Previous photo ([)' },
    photoNext: { text: 'Next', title: 'Next photo (])' },
    photoClose: { text: 'Render only', title: 'Only the render (Esc)' },
    asPhotographed: 'as photographed',
    asPhotographedHelp: { title: 'The render with the exposure of the photo, and through its lens, as training learned them (L)' },
    pixel: 'Pixel', pixelClose: { title: 'Close (Esc)' },
    pixelAt: (x, y, gaussians) => `${x}, ${y} · ${count(gaussians, GAUSSIANS)}`,
    pixelSum: (color, percent, depth) => `${color}, ${percent} % opaque${depth === null ? '' : `, half the light from before ${depth}`}`,
    pixelColumns: ['id', 'depth', 'alpha', 'weight', 'left'],
    // Panel: camera path and film.
    film: 'Camera path',
    filmKeys: (keys) => (keys ? count(keys, KEYS) : 'add keys as you look around'),
    filmGo: 'Go there', filmDrop: 'Remove',
    filmAdd: { text: 'Add key', title: 'Add the present view (K)' },
    filmPreview: 'Preview', filmStop: 'Stop', filmClear: 'Clear',
    filmSave: { text: 'Save', title: "Save the path's keys as a file" },
    filmLoad: { text: 'Load', title: 'Load keys from a file' },
    filmUnreadable: (file, reason) => `${file} is not a camera path of this page: ${reason}`, filmKeysBroken: 'its keys are not whole',
    seconds: 'Seconds', framesPerSecond: 'Frames/s', filmSize: 'Size', closedLoop: 'closed loop',
    filmNote: (frames, picture, gif, megabytes) => `${count(frames, FRAMES)} of ${picture}; the GIF has ${gif}, about ${number(megabytes, megabytes < 10 ? 1 : 0)} MB`,
    filmRender: 'Render film', filmCancel: 'Cancel',
    filmWaits: (films) => (films ? `waiting for ${films === 1 ? 'another film' : count(films, FILMS)}` : 'waiting'),
    filmFrame: (done, all) => `frame ${done} of ${all}`,
    filmJoins: 'putting it together', theFilm: 'the film', gif: 'GIF', mp4: 'MP4', filmPath: 'path',
    filmFiles: (folder, note) => `Frames in ${folder}${note ? `; ${note}` : ''}`,
    // The list of keys.
    listTitle: 'Mouse, touch, keys', listClose: 'Close',
    mouseAndTouch: { rows: [
        ['Mouse'], ['left or middle drag', 'orbit (look around in fly mode)'], ['right, Shift or Shift-middle drag', 'pan'],
        ['wheel, Ctrl drag', 'closer, farther'], ['double click', 'turn around what is there'], ['Alt click', 'inspect a pixel'],
        ['Touch'], ['one finger', 'orbit'], ['two fingers', 'pan and zoom'], ['double tap', 'turn around what is there']
    ] },
    keys: { rows: [
        ['Keys'], ['W A S D, Q E', 'fly; Shift faster, Alt slower'], ['arrows', 'orbit'], ['+ −', 'closer, farther'],
        ['1 … 6', 'splats, centres, ellipsoids, depth, tiles, normals'], ['V, I, C', 'fly, inspect, cameras'],
        ['G, B, N, M', 'lasso, brush, sphere, measure; Shift adds, Alt removes'], ['Del, Ctrl Z, Ctrl Shift Z', 'delete the selection, undo, redo'],
        ['F, Home', 'face the pivot, first view'], ['Shift F', 'whole screen'], ['[ ]', 'photo before, after'],
        ['L', "as photographed: the photo's exposure and lens"], ['K, P', 'add a key, screenshot'], ['X', 'filter off, and on again'],
        ['Space', 'pause training, and go on'], ['O', 'open a file, where none was given'], ['H, Esc, ?', 'panel, close, this list']
    ] }
};
