// What scrolls can be reached by keyboard, and each code block's buttons have a name of their own.
const mend = () => {
  document.querySelectorAll(".md-typeset__scrollwrap, pre > code, math[display=block]").forEach(box => box.tabIndex = 0);
  document.querySelectorAll(".md-code__nav").forEach((nav, i) => nav.setAttribute("aria-label", `Code ${i + 1}`));
};
new MutationObserver(mend).observe(document, { childList: true, subtree: true });
