// --- the page: scenes, curves, tables, theme, keys ---

const source = document.getElementById('data');
const data = JSON.parse(source.textContent);
source.remove(); // its text would stand in memory twice
const scenes = [...document.querySelectorAll('.player')].map((root) => new Scene(data.scenes[root.dataset.scene], root));
const curves = [...document.querySelectorAll('[data-curves]')].map((root) => {
  const each = data.curves[root.dataset.curves];
  return new Curves(each, root, each.scene === null ? undefined : scenes[each.scene]);
});

function repaint() {
  for (const scene of scenes) {
    scene.colours = null;
    scene.redraw(true);
  }
}

const root = document.documentElement;
const dark = window.matchMedia('(prefers-color-scheme: dark)');
const isDark = () => (root.dataset.theme ?? (dark.matches ? 'dark' : 'light')) === 'dark';
const theme = document.getElementById('theme');
function nameTheme() {
  theme.setAttribute('aria-label', isDark() ? 'Light colours' : 'Dark colours');
  theme.title = theme.getAttribute('aria-label');
}
theme.addEventListener('click', () => {
  root.dataset.theme = isDark() ? 'light' : 'dark';
  nameTheme();
  repaint();
});
dark.addEventListener('change', () => {
  nameTheme();
  repaint();
});
nameTheme();

// Paper is white, and pictures are drawn before it is printed.
let screenTheme;
window.addEventListener('beforeprint', () => {
  screenTheme = root.dataset.theme;
  root.dataset.theme = 'light';
  for (const scene of scenes) {
    scene.colours = null;
    scene.stale = true;
    scene.draw();
  }
});
window.addEventListener('afterprint', () => {
  if (screenTheme === undefined) delete root.dataset.theme;
  else root.dataset.theme = screenTheme;
  repaint();
});

// Keys go to the scene they are pressed in, else to the one that was used last.
let current = scenes[0];
for (const scene of scenes) {
  for (const name of ['pointerdown', 'focusin']) scene.root.addEventListener(name, () => { current = scene; });
}
document.addEventListener('keydown', (event) => {
  if (!current || event.ctrlKey || event.metaKey || event.altKey) return;
  const { target } = event;
  // Elements keep the keys that they answer to themselves.
  const slider = target.matches('input[type=range]');
  if (target.matches('select, textarea') || (slider && event.key !== ' ' && !/^[-+=]$|^Escape$/.test(event.key))) return;
  if (event.key === ' ' && target.matches('button, summary, a, input:not([type=range])')) return;
  if (current.key(event)) event.preventDefault();
});

for (const table of document.querySelectorAll('table')) {
  const body = table.tBodies[0];
  table.querySelectorAll('button.sort').forEach((button, column) => {
    button.addEventListener('click', () => {
      const up = button.parentElement.getAttribute('aria-sort') !== 'ascending';
      for (const head of table.tHead.rows[0].cells) head.removeAttribute('aria-sort');
      button.parentElement.setAttribute('aria-sort', up ? 'ascending' : 'descending');
      const value = (row) => row.cells[column].dataset.order ?? row.cells[column].textContent;
      const order = new Intl.Collator('en', { numeric: true });
      const compare = (a, b) => {
        const [x, y] = [value(a), value(b)];
        const numbers = x !== '' && y !== '' && Number.isFinite(Number(x)) && Number.isFinite(Number(y));
        return numbers ? x - y : order.compare(x, y);
      };
      body.append(...[...body.rows].sort((a, b) => (up ? compare(a, b) : compare(b, a))));
    });
  });
}

// For those who script the page.
window.report = { scenes, curves };
