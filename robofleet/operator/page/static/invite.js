// Lets another phone or computer in: an address that one browser opens, and its code for a phone's camera.

export class Invitations {
  #shown = document.getElementById("invite-shown");
  #text = document.getElementById("invite-text");

  constructor() {
    for (const button of document.querySelectorAll("[data-invite]")) {
      button.addEventListener("click", () => this.#invite(button.dataset.invite));
    }
  }

  async #invite(role) {
    this.#shown.hidden = true;
    this.#text.textContent = `${role}: asked`;
    try {
      const response = await fetch(`invite/${role}`, { method: "POST" });
      if (!response.ok) throw new Error(`${response.status}`);
      const { address, code } = await response.json();
      this.#text.textContent = `For one ${role}; it opens the page in one browser:`;
      document.getElementById("invite-code").src = code;
      document.getElementById("invite-address").textContent = address;
      this.#shown.hidden = false;
    } catch {
      this.#text.textContent = "No address was made: look whether the link is there, and try again.";
    }
  }
}
